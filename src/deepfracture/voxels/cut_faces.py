"""The faces between voxels that cracks cut, as a bit mask: bit `1 << axis` of a voxel is its face towards the next
voxel along that axis (`Volume.cuts`)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def cut_faces(labels: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Bits 1, 2, 4 where two positive labels meet at the face towards the next voxel along x, y, z."""
    return _cut_faces(np.ascontiguousarray(labels))


@njit(cache=True)
def _cut_faces(labels: np.ndarray) -> np.ndarray:
    n0, n1, n2 = labels.shape
    cuts = np.zeros((n0, n1, n2), np.uint8)
    for i in range(n0):
        for j in range(n1):
            line, bits = labels[i, j], cuts[i, j]
            if i + 1 < n0:
                mark_cut_faces(line, labels[i + 1, j], bits, 1)
            if j + 1 < n1:
                mark_cut_faces(line, labels[i, j + 1], bits, 2)
            mark_cut_faces(line[: n2 - 1], line[1:], bits, 4)
    return cuts


@njit(cache=True, inline="always")
def mark_cut_faces(here: np.ndarray, there: np.ndarray, bits: np.ndarray, bit: int) -> None:
    """Set `bit` where two lines of labels have one each, and not the same."""
    for k in range(len(here)):
        cut = (here[k] != there[k]) & (here[k] > 0) & (there[k] > 0)
        bits[k] |= np.uint8(cut) * np.uint8(bit)
