"""From cracks to fragments: cut the faces between voxels, flood what still hangs together, merge the dust."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.types import Floats, Ints, Labels

from .growth import Crack, Front


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
            faces.append((float(i), float(j), float(k), float(axis), share, normals[q, 0], normals[q, 1], normals[q, 2]))
    return faces


def open_faces(crack: Crack, front: Front, cut: np.ndarray, position: np.ndarray) -> Floats:
    """Cut the lattice along `crack`. Returns the new faces: voxel, axis, share of the edge, normal, shape (n, 8)."""
    if not len(crack.voxels):
        return np.zeros((0, 8))
    return np.array(_crossings(crack.voxels, crack.offset, crack.normals, front.status, position, cut)).reshape(-1, 8)


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


def _shared_faces(labels: Labels) -> Ints:
    """Pairs of different labels that touch, once a face and both ways round, shape (n, 2)."""
    pairs = []
    for axis in range(3):
        a = np.moveaxis(labels, axis, 0)
        low, high = a[:-1].ravel(), a[1:].ravel()
        touch = (low != high) & (low > 0) & (high > 0)
        pairs.append(np.stack([low[touch], high[touch]], axis=1))
    found = np.concatenate(pairs)
    return np.concatenate([found, found[:, ::-1]]).astype(np.int64)


def _renumbered(labels: Labels) -> Labels:
    values, inverse = np.unique(labels, return_inverse=True)
    first = 0 if len(values) and values[0] == 0 else 1
    return (inverse.reshape(labels.shape) + first).astype(np.int32)


def merge_dust(labels: Labels, smallest: int) -> Labels:
    """Give each piece below `smallest` voxels to the neighbour that it shares most faces with."""
    labels = labels.copy()
    while True:
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        dust = np.flatnonzero((sizes > 0) & (sizes < smallest))
        if not len(dust):
            return _renumbered(labels)
        size_of = labels.max() + 1
        pairs, faces = np.unique(_shared_faces(labels) @ [size_of, 1], return_counts=True)
        own, other = pairs // size_of, pairs % size_of
        merged = False
        for piece in dust[np.argsort(sizes[dust])]:
            mine = own == piece
            if mine.any():
                labels[labels == piece] = other[mine][faces[mine].argmax()]
                merged = True
                break
        if not merged:  # what is left touches nothing: bodies of their own
            return _renumbered(labels)


def fragments_of(inside: np.ndarray, cut: np.ndarray, smallest: int) -> Labels:
    """Labels 1..n of the pieces that the cut faces part, none below `smallest` voxels, shape of `inside`."""
    labels, _ = _flood(inside, cut)
    return merge_dust(labels, smallest)
