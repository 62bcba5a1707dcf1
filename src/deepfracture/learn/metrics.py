"""How far two ways of dividing a body are apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepfracture.types import BadInput


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
    joint = pairs.reshape(len(names_a), len(names_b)) / a.size
    return max(0.0, 2 * _entropy(joint.ravel()) - _entropy(joint.sum(axis=0)) - _entropy(joint.sum(axis=1)))


def _entropy(p: NDArray) -> float:
    p = p[p > 0]
    return float(-(p * np.log2(p)).sum())
