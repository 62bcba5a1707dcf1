"""Distance between two partitions of a body into fragments, in bits."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from deepfracture.types import BadInput, Floats, Ints


def variation_of_information(a: ArrayLike, b: ArrayLike, mask: ArrayLike | None = None) -> float:
    """H(a | b) + H(b | a) in bits, over the voxels of `mask` (Meila 2007); 0 for equal partitions.

    Args:
        a: Labels, any shape.
        b: Labels, the same shape.
        mask: Voxels to compare, all by default.

    Raises:
        BadInput: The shapes differ or the mask is empty.
    """
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape:
        raise BadInput(f"labels must have the same shape, got {a.shape} and {b.shape}")
    a, b = (a.ravel(), b.ravel()) if mask is None else (a[np.asarray(mask)], b[np.asarray(mask)])
    if not a.size:
        raise BadInput("mask must contain at least one voxel, got none")
    names_a, in_a = np.unique(a, return_inverse=True)
    names_b, in_b = np.unique(b, return_inverse=True)
    pairs = np.bincount(in_a * len(names_b) + in_b, minlength=len(names_a) * len(names_b))
    return table_variation(pairs.reshape(len(names_a), len(names_b)))


def table_variation(table: NDArray) -> float:
    """Variation of information [bits] of a contingency table: voxels in each pair of parts, shape (n, m)."""
    joint = table / table.sum()
    return max(0.0, 2 * _entropy(joint.ravel()) - _entropy(joint.sum(axis=0)) - _entropy(joint.sum(axis=1)))


def normalized_mutual_information(table: NDArray) -> float:
    """Mutual information over joint entropy of a contingency table: 1 for equal partitions (also two of one part),
    0 for independent ones, for any number of parts."""
    entropy = _entropy((table / table.sum()).ravel())
    return 1.0 - table_variation(table) / entropy if entropy > 0 else 1.0


def contingency_table(a: NDArray, b: NDArray, count_a: int, count_b: int) -> Ints:
    """Voxels in each pair of labels 0..count, shape (count_a + 1, count_b + 1), without those that are 0 in both."""
    return _contingency_table(a.ravel(), b.ravel(), count_a, count_b)


@njit(cache=True)
def _contingency_table(a, b, count_a, count_b):
    table = np.zeros((count_a + 1, count_b + 1), np.int64)
    for n in range(len(a)):
        table[a[n], b[n]] += 1
    table[0, 0] = 0
    return table


def _entropy(p: Floats) -> float:
    p = p[p > 0]
    return float(-(p * np.log2(p)).sum())
