"""The embedding space: latent codes of the training patterns, and the nearest ones (paper, eq. 8)."""

from __future__ import annotations

import numpy as np

from deepfracture.types import Floats32, Ints


def nearest_first(codes: Floats32, wanted: Floats32) -> Ints:
    """Indices of the codes, shape (n, m), in the order of their distance to `wanted`, shape (m,)."""
    return np.argsort(((codes - wanted) ** 2).sum(axis=1), kind="stable")
