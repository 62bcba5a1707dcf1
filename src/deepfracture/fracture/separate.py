"""From cracks to fragments: cut the faces between voxels, flood what still hangs together, merge the dust."""

from __future__ import annotations

import heapq

import numpy as np
from numba import njit
from scipy.ndimage import distance_transform_edt

from deepfracture.fracture.growth import Crack, Front
from deepfracture.types import Floats, Labels


@njit(cache=True)
def _crossings(voxels, offset, normals, status, position, cut):
    """Mark the faces where the sheet passes between two voxels of the crack; where on the edge it does."""
    faces = []
    for q in range(voxels.shape[0]):
        i, j, k = voxels[q]
        position[i, j, k] = q
    for q in range(voxels.shape[0]):
        i, j, k = voxels[q]
        for axis in range(3):
            a, b, c = i + (axis == 0), j + (axis == 1), k + (axis == 2)
            if status[a, b, c] == 0:
                continue
            other = position[a, b, c]
            if (offset[q] < 0) == (offset[other] < 0) or cut[i, j, k] & (1 << axis):
                continue
            cut[i, j, k] |= 1 << axis
            share = abs(offset[q]) / (abs(offset[q]) + abs(offset[other]) + 1e-12)
            faces.append(
                (float(i), float(j), float(k), float(axis), share, normals[q, 0], normals[q, 1], normals[q, 2])
            )
    return faces


def open_faces(crack: Crack, front: Front, position: np.ndarray) -> Floats:
    """Cut the lattice along `crack`. Returns the new faces: voxel, axis, share of the edge, normal, shape (n, 8)."""
    if not len(crack.voxels):
        return np.zeros((0, 8))
    return np.array(_crossings(crack.voxels, crack.offset, crack.normals, front.status, position, front.cut)).reshape(
        -1, 8
    )


@njit(cache=True)
def _find(parent, a):
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@njit(cache=True)
def _flood(inside, cut):
    """Connected voxels of `inside` that no cut face parts; labels 1..n, 0 outside."""
    nx, ny, nz = inside.shape
    parent = np.arange(nx * ny * nz)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if not inside[i, j, k]:
                    continue
                for axis in range(3):
                    a, b, c = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                    if a < nx and b < ny and c < nz and inside[a, b, c] and not cut[i, j, k] & (1 << axis):
                        p, q = _find(parent, (i * ny + j) * nz + k), _find(parent, (a * ny + b) * nz + c)
                        if p != q:
                            parent[max(p, q)] = min(p, q)
    labels = np.zeros((nx, ny, nz), np.int32)
    number = np.zeros(nx * ny * nz, np.int32)
    count = 0
    for v in range(nx * ny * nz):
        i, j, k = v // (ny * nz), v // nz % ny, v % nz
        if inside[i, j, k]:
            root = _find(parent, v)
            if number[root] == 0:
                count += 1
                number[root] = count
            labels[i, j, k] = number[root]
    return labels, count


@njit(cache=True)
def _contacts(labels):
    """The two labels at each face between unlike pieces, as low * count + high with count = highest label + 1."""
    nx, ny, nz = labels.shape
    count = np.int64(labels.max()) + 1
    keys = [np.int64(0) for _ in range(0)]
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                here = labels[i, j, k]
                if here == 0:
                    continue
                for axis in range(3):
                    a, b, c = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                    there = labels[a, b, c] if a < nx and b < ny and c < nz else here
                    if there != here and there != 0:
                        keys.append(min(here, there) * count + max(here, there))
    return np.array(keys)


def _neighbours(labels: Labels) -> list[dict[int, int]]:
    """For each label the labels that touch it and how many faces they share."""
    count = int(labels.max()) + 1
    touching: list[dict[int, int]] = [{} for _ in range(count)]
    keys, shared = np.unique(_contacts(labels), return_counts=True)
    for a, b, faces in zip((keys // count).tolist(), (keys % count).tolist(), shared.tolist(), strict=True):
        touching[a][b] = touching[b][a] = faces
    return touching


def merge_dust(labels: Labels, smallest: int) -> Labels:
    """Give each piece below `smallest` voxels, smallest first, to the neighbour it shares most faces with.

    Dust that touches nothing goes to the nearest piece: voxels that hang by an edge in a thin tip. Labels are
    renumbered without gaps."""
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    home = np.arange(len(sizes))
    dusty = bool(((sizes > 0) & (sizes < smallest)).any())
    touching = _neighbours(labels) if dusty else []
    queue = [(int(sizes[piece]), int(piece)) for piece in np.flatnonzero((sizes > 0) & (sizes < smallest))]
    heapq.heapify(queue)
    while queue:
        size, piece = heapq.heappop(queue)
        if size != sizes[piece] or home[piece] != piece or not touching[piece]:
            continue  # grew meanwhile, is gone already, or touches nothing
        into = max(touching[piece], key=lambda other: (touching[piece][other], -other))
        home[piece] = into
        sizes[into] += size
        for other, faces in touching[piece].items():
            del touching[other][piece]
            if other != into:
                touching[into][other] = touching[other][into] = touching[into].get(other, 0) + faces
        if sizes[into] < smallest:
            heapq.heappush(queue, (int(sizes[into]), int(into)))
    while (home[home] != home).any():  # what took a piece in may itself have joined another
        home = home[home]
    present = np.bincount(labels.ravel(), minlength=len(sizes)) > 0
    present[0] = False
    kept = np.unique(home[present])
    merged = np.where(present, np.searchsorted(kept, home) + 1, 0).astype(np.int32)[labels]
    large = np.append(False, sizes[kept] >= smallest)
    return merged if large[1:].all() or not large.any() else _nearest_large(merged, large)


def _nearest_large(labels: Labels, large: np.ndarray) -> Labels:
    """Labels with only the `large` ones (by label) left, renumbered; their voxels take in the others."""
    nearest = distance_transform_edt(~large[labels], return_distances=False, return_indices=True)
    number = np.where(large, np.cumsum(large), 0).astype(np.int32)
    return np.where(labels > 0, number[labels[tuple(np.asarray(nearest))]], 0).astype(np.int32)


def fragments_of(inside: np.ndarray, cut: np.ndarray, smallest: int) -> Labels:
    """Labels 1..n of the pieces that the cut faces part, none below `smallest` voxels, shape of `inside`."""
    labels, _ = _flood(inside, cut)
    return merge_dust(labels, smallest)
