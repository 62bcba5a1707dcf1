"""How far two ways of dividing a body are apart, in bits."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from deepfracture.types import BadInput, Floats, Ints


def variation_of_information(a: ArrayLike, b: ArrayLike, mask: ArrayLike | None = None) -> float:
    """H(a | b) + H(b | a) in bits, over the voxels of `mask` (Meila 2007). 0: the same division.

    Args:
        a: Labels, any shape.
        b: Labels, the same shape.
        mask: Voxels that count, all by default.

    Raises:
        BadInput: The shapes differ or nothing is left to compare.
    """
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape:
        raise BadInput(f"labels must have the same shape, got {a.shape} and {b.shape}")
    a, b = (a.ravel(), b.ravel()) if mask is None else (a[np.asarray(mask)], b[np.asarray(mask)])
    if not a.size:
        raise BadInput("mask must hold a voxel at least, got none")
    names_a, in_a = np.unique(a, return_inverse=True)
    names_b, in_b = np.unique(b, return_inverse=True)
    pairs = np.bincount(in_a * len(names_b) + in_b, minlength=len(names_a) * len(names_b))
    return information_of(pairs.reshape(len(names_a), len(names_b)))


def information_of(sizes: NDArray) -> float:
    """The variation of information of a contingency table: voxels that two parts have in common, shape (n, m)."""
    joint = sizes / sizes.sum()
    return max(0.0, 2 * _entropy(joint.ravel()) - _entropy(joint.sum(axis=0)) - _entropy(joint.sum(axis=1)))


def shared_information(sizes: NDArray) -> float:
    """Of the same table, the mutual information over the joint entropy: 1 for the same division, 0 for two that know
    nothing of each other, however many parts they have. 1 if both are whole."""
    joint = sizes / sizes.sum()
    together = _entropy(joint.ravel())
    return 1.0 - information_of(sizes) / together if together > 0 else 1.0


def joint_sizes(a: NDArray, b: NDArray, count_a: int, count_b: int) -> Ints:
    """The contingency table of labels 0..count, shape (count_a + 1, count_b + 1), without what is 0 in both."""
    return _joint(a.ravel(), b.ravel(), count_a, count_b)


@njit(cache=True)
def _joint(a, b, count_a, count_b):
    sizes = np.zeros((count_a + 1, count_b + 1), np.int64)
    for n in range(len(a)):
        sizes[a[n], b[n]] += 1
    sizes[0, 0] = 0
    return sizes


def _entropy(p: Floats) -> float:
    p = p[p > 0]
    return float(-(p * np.log2(p)).sum())
