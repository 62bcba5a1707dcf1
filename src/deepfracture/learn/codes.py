"""Latent codes: the frozen encoder of impulses, and look-up in the codebook (vector quantisation)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from deepfracture.types import Floats32, Ints

OMEGA = 30.0
"""Frequency of the sine layer (Sitzmann et al. 2020)."""


def siren_shapes(impulse_size: int) -> dict[str, tuple[int, ...]]:
    """The shapes of the sine layer's weights."""
    return {"siren.weight": (7, impulse_size), "siren.bias": (impulse_size,)}


def draw_siren(impulse_size: int, rng: np.random.Generator) -> dict[str, Floats32]:
    """Initial weights of the first layer of a SIREN (Sitzmann et al. 2020). They stay as drawn: the encoder E is
    never back-propagated through (paper, section 4.2.6)."""
    weight = rng.uniform(-1 / 7, 1 / 7, (7, impulse_size))
    bias = rng.uniform(-1, 1, impulse_size) / np.sqrt(7)
    return {"siren.weight": weight.astype(np.float32), "siren.bias": bias.astype(np.float32)}


def encode_impulses(siren: Mapping[str, Any], impulses: Any, xp: Any = np) -> Any:
    """Z^impulse = sin(omega (W J^norm + b)) of each impulse (SIREN, Sitzmann et al. 2020).

    Args:
        impulses: Rows J^norm, shape (n, features, 7).
        xp: numpy or torch, whichever the arrays belong to.

    Returns:
        Codes of a sample's impulses one after another, shape (n, features * impulse_size).
    """
    codes = xp.sin(OMEGA * (impulses @ siren["siren.weight"] + siren["siren.bias"]))
    return codes.reshape(len(impulses), -1)


def nearest_codes(codebook: Floats32, code: Floats32) -> Ints:
    """Indices of the codebook, shape (n, m), by ascending distance to `code`, shape (m,).

    The first is the vector quantisation of `code` (VQ-VAE, van den Oord et al. 2017; paper, eq. 8)."""
    return np.argsort(((codebook - code) ** 2).sum(axis=1), kind="stable")
