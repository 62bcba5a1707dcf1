"""From cracks to fragments: cut faces between voxels, connected components, small ones merged."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.fracture.growth import Crack, Front
from deepfracture.types import Floats, Labels
from deepfracture.voxels import connected_components, merge_small_components


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


def fragments_of(inside: np.ndarray, cut: np.ndarray, smallest: int) -> Labels:
    """Labels 1..n of the pieces that the cut faces part, none below `smallest` voxels, shape of `inside`."""
    return merge_small_components(connected_components(inside, cut), smallest)
