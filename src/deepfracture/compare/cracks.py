"""Area of the crack surfaces between fragments, and which way they face.

Both come from the faces between voxels of different labels. Their number is biased: a staircase has up to sqrt(3)
times the area of the plane that it approximates. The normal n at a face is estimated from the vector area of the
staircase around it, which equals that of the smooth surface for any neighbourhood (a thin wall may cut it off). A
face across axis k then represents the area h^2 |n_k|, since a plane of area A has A |n_k| / h^2 faces across axis k
and the n_k^2 add up to 1. Only labels are read: the distance field of a predicted pattern is the distance to the
outer surface where that is nearer.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import njit

from deepfracture.types import Floats, Labels

BINS = 48
"""Bins of equal area on the half sphere of axes."""
MAX_FACES = 4096
"""Faces sampled, evenly strided: the area is then accurate to a percent."""
REACH = 2
"""Half width of the neighbourhood in which a normal is estimated [voxels]."""
SHARPNESS = 12.5
"""A normal is spread over bins as exp(SHARPNESS cos^2), about a bin wide (0.2 rad): with hard bins two nearly parallel
cracks would be as dissimilar as two perpendicular ones."""


def crack_surface(labels: Labels, spacing: float) -> tuple[float, Floats]:
    """Area [m^2] of all cracks, and the fraction of it that faces each of BINS axes.

    Args:
        labels: Fragment of each voxel, 0 outside, shape (r, r, r).
        spacing: Side of a voxel [m].

    Returns:
        Area, and fractions that add up to 1 (all zero without a crack), shape (BINS,).
    """
    labels = np.pad(labels, REACH + 1)
    faces = _interface_faces(labels, REACH)
    if not len(faces):
        return 0.0, np.zeros(BINS)
    stride = -(-len(faces) // MAX_FACES)
    normals, areas = _face_normals(labels, faces[::stride], REACH)
    areas *= stride
    area = float(areas.sum())
    weights = np.exp(SHARPNESS * ((normals @ axes().T) ** 2 - 1))
    weights *= (areas / weights.sum(axis=1))[:, None]
    return area * spacing**2, weights.sum(axis=0) / area


@cache
def axes() -> Floats:
    """Centre of each bin: a Fibonacci lattice on the upper half sphere (Gonzalez 2010), shape (BINS, 3)."""
    n = np.arange(BINS)
    z = (n + 0.5) / BINS
    azimuth = np.pi * (3 - np.sqrt(5)) * n
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


@njit(cache=True)
def _interface_faces(labels, margin):
    """Every face between two fragments, as 3 * (flat index of its lower voxel) + axis, without the outer voxels."""
    n = labels.shape[0]
    faces = [0 for _ in range(0)]
    for i in range(margin, n - margin - 1):
        for j in range(margin, n - margin - 1):
            for k in range(margin, n - margin - 1):
                here = labels[i, j, k]
                if here == 0:
                    continue
                for axis in range(3):
                    there = labels[i + (axis == 0), j + (axis == 1), k + (axis == 2)]
                    if there != 0 and there != here:
                        faces.append(3 * ((i * n + j) * n + k) + axis)
    return np.array(faces)


@njit(cache=True)
def _face_normals(labels, faces, reach):
    """Unit normals (n, 3) of the crack surface at `faces`, and its area per face of the staircase (n,) [voxels^2]."""
    n = labels.shape[0]
    normals, areas = np.empty((len(faces), 3)), np.empty(len(faces))
    for f in range(len(faces)):
        voxel, axis = faces[f] // 3, faces[f] % 3
        i, j, k = voxel // (n * n), voxel // n % n, voxel % n
        here, there = labels[i, j, k], labels[i + (axis == 0), j + (axis == 1), k + (axis == 2)]
        x, y, z = _vector_area(labels, i, j, k, axis, here, there, reach)
        length = np.sqrt(x * x + y * y + z * z)
        normals[f] = x / length, y / length, z / length
        areas[f] = abs(normals[f, axis])
    return normals, areas


@njit(cache=True)
def _vector_area(labels, i, j, k, axis, here, there, reach):
    """Weighted vector area of the faces from `here` to `there` around a face; nearer ones have more weight."""
    x = y = z = 0.0
    wide = (reach + 1.0) ** 2
    ci, cj, ck = i + 0.5 * (axis == 0), j + 0.5 * (axis == 1), k + 0.5 * (axis == 2)
    for a in range(i - reach, i + reach + 1):
        for b in range(j - reach, j + reach + 1):
            for c in range(k - reach, k + reach + 1):
                first = labels[a, b, c]
                if first != here and first != there:
                    continue
                other = there if first == here else here
                sign = 1.0 if first == here else -1.0
                if labels[a + 1, b, c] == other:
                    x += sign * max(0.0, wide - (a + 0.5 - ci) ** 2 - (b - cj) ** 2 - (c - ck) ** 2)
                if labels[a, b + 1, c] == other:
                    y += sign * max(0.0, wide - (a - ci) ** 2 - (b + 0.5 - cj) ** 2 - (c - ck) ** 2)
                if labels[a, b, c + 1] == other:
                    z += sign * max(0.0, wide - (a - ci) ** 2 - (b - cj) ** 2 - (c + 0.5 - ck) ** 2)
    if x == 0.0 and y == 0.0 and z == 0.0:  # opposite faces cancel around a single voxel
        return 1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2)
    return x, y, z
