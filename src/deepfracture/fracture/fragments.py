"""From cracks to fragments: cut faces between voxels, connected components, small ones merged."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepfracture.fracture.growth import Crack, MarchState
from deepfracture.types import Floats, Labels
from deepfracture.voxels import connected_components, merge_small_components


@njit(cache=True)
def _cut_faces(voxels, offset, normals, status, position, cut):
    """Mark the faces where the level set changes sign between two voxels of the crack, with the edge parameter t."""
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
            t = abs(offset[q]) / (abs(offset[q]) + abs(offset[other]) + 1e-12)
            faces.append((float(i), float(j), float(k), float(axis), t, normals[q, 0], normals[q, 1], normals[q, 2]))
    return faces


def cut_faces(crack: Crack, march: MarchState, position: np.ndarray) -> Floats:
    """Cut the faces along `crack`. Returns the new ones: voxel, axis, edge parameter t, normal, shape (n, 8)."""
    if not len(crack.voxels):
        return np.zeros((0, 8))
    return np.array(_cut_faces(crack.voxels, crack.offset, crack.normals, march.status, position, march.cut)).reshape(
        -1, 8
    )


def label_fragments(inside: np.ndarray, cut: np.ndarray, min_voxels: int) -> Labels:
    """Labels 1..n of the fragments that the cut faces separate, none below `min_voxels`, shape of `inside`."""
    return merge_small_components(connected_components(inside, cut), min_voxels)
