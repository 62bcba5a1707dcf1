"""The embedding space: latent codes of the training patterns, and the nearest one (paper, eq. 8)."""

from __future__ import annotations

from deepfracture.types import Floats32


def quantise(codes: Floats32, wanted: Floats32) -> int:
    """Index of the code nearest to `wanted`, shape (m,), in the codebook `codes`, shape (n, m)."""
    return int(((codes - wanted) ** 2).sum(axis=1).argmin())
