"""Area of the crack surfaces between fragments, and which way they face.

Both come from the faces between voxels of different labels. Their bare number is biased: a staircase has up to
sqrt(3) times the area of the plane that it stands for. The true normal n at a face is estimated from the vector area
of the staircase around it, which is that of the smooth surface whatever the shape of the neighbourhood (a thin wall
may cut it off). A face across axis k then stands for the area h^2 |n_k|, since a plane of area A has A |n_k| / h^2
faces across axis k and the n_k^2 add up to 1. Labels alone are read: the distance of a predicted pattern is that to
the surface where the surface is nearer.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import njit

from deepfracture.types import Floats, Labels

BINS = 48
"""Axial bins of equal area on the half sphere."""
FACES = 4096
"""Faces that are looked at, evenly strided, however many there are: the area is then good to a percent."""
REACH = 2
"""Voxels around a face in which its normal is estimated."""
SHARPNESS = 12.5
"""A normal counts for bins around it as exp(SHARPNESS cos^2), about a bin wide (0.2 rad): hard bins would make
two nearly parallel cracks as unlike as two perpendicular ones."""


def crack_surface(labels: Labels, spacing: float) -> tuple[float, Floats]:
    """Area [m^2] of all cracks, and the share of it that faces each of BINS directions up to sign.

    Args:
        labels: Fragment of each voxel, 0 outside, shape (r, r, r).
        spacing: Side of a voxel [m].

    Returns:
        Area, and shares that add up to 1 (all zero without a crack), shape (BINS,).
    """
    normals, areas = _faces(np.pad(labels, REACH + 1), FACES, REACH)
    area = float(areas.sum())
    if area == 0:
        return 0.0, np.zeros(BINS)
    near = np.exp(SHARPNESS * ((normals @ axes().T) ** 2 - 1))
    near *= (areas / near.sum(axis=1))[:, None]
    return area * spacing**2, near.sum(axis=0) / area


@cache
def axes() -> Floats:
    """Middle of each bin: a Fibonacci lattice on the upper half sphere (Gonzalez 2010), shape (BINS, 3)."""
    n = np.arange(BINS)
    z = (n + 0.5) / BINS
    turn = np.pi * (3 - np.sqrt(5)) * n
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


@njit(cache=True)
def _faces(labels, most, reach):
    """Unit normals (n, 3) and areas (n,) [voxels^2] of at most about `most` faces between different fragments."""
    r = labels.shape[0] - reach - 1
    total = 0
    for i in range(reach, r):
        for j in range(reach, r):
            for k in range(reach, r):
                here = labels[i, j, k]
                if here == 0:
                    continue
                for axis in range(3):
                    there = labels[i + (axis == 0), j + (axis == 1), k + (axis == 2)]
                    total += there != 0 and there != here
    stride = (total + most - 1) // most
    size = (total + stride - 1) // stride if total else 0
    normals = np.empty((size, 3))
    areas = np.empty(size)
    number = found = 0
    for i in range(reach, r):
        for j in range(reach, r):
            for k in range(reach, r):
                here = labels[i, j, k]
                if here == 0:
                    continue
                for axis in range(3):
                    there = labels[i + (axis == 0), j + (axis == 1), k + (axis == 2)]
                    if there == 0 or there == here:
                        continue
                    if number % stride == 0:
                        x, y, z = _vector_area(labels, i, j, k, axis, here, there, reach)
                        length = np.sqrt(x * x + y * y + z * z)
                        normals[found] = x / length, y / length, z / length
                        areas[found] = stride * abs(normals[found, axis])
                        found += 1
                    number += 1
    return normals, areas


@njit(cache=True)
def _vector_area(labels, i, j, k, axis, here, there, reach):
    """Sum of the faces from `here` to `there` around a face, nearer ones counting more."""
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
    if x == 0.0 and y == 0.0 and z == 0.0:  # opposite faces cancel, around a voxel on its own
        return 1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2)
    return x, y, z
