"""Spatial variation of a material: smooth, periodic Gaussian random fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepfracture.fracture.padded_grid import PaddedGrid
from deepfracture.types import Floats32, Material

WAVELENGTHS = (0.5, 0.25, 0.12)
"""Wavelengths of the waviness of crack surfaces [m]."""


def random_field(grid: PaddedGrid, length: float, rng: np.random.Generator) -> Floats32:
    """A periodic Gaussian field of zero mean and unit variance, correlated over `length` [m], shape (n, n, n)."""
    noise = np.fft.rfftn(rng.standard_normal(grid.shape))
    full = np.fft.fftfreq(grid.n, grid.spacing) * 2 * np.pi
    half = np.fft.rfftfreq(grid.n, grid.spacing) * 2 * np.pi
    squared = full[:, None, None] ** 2 + full[None, :, None] ** 2 + half[None, None, :] ** 2
    field = np.fft.irfftn(noise * np.exp(-0.25 * squared * length**2), s=grid.shape, axes=(0, 1, 2))
    field -= field.mean()
    return (field / max(field.std(), 1e-12)).astype(np.float32)


def waviness(grid: PaddedGrid, lengths: Sequence[float], rng: np.random.Generator) -> Floats32:
    """Fields superposed with amplitudes proportional to their lengths: self-affine over these, unit variance."""
    total = sum(length * random_field(grid, length, rng) for length in lengths)
    return (total / np.std(total)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Variation:
    """One realisation of the material's randomness on the coarse grid."""

    strength: Floats32
    """Factor on the strength, shape (m, m, m)."""
    toughness: Floats32
    """[Pa sqrt(m)], shape (m, m, m)."""
    waviness: Floats32
    """Displacement of crack surfaces along their normal [m], periodic, shape (m, m, m)."""

    @staticmethod
    def draw(material: Material, grid: PaddedGrid, rng: np.random.Generator) -> Variation:
        weak = np.exp(material.variation_spread * random_field(grid, material.variation_length, rng))
        tough = np.exp(material.variation_spread * random_field(grid, material.variation_length, rng))
        displacement = material.roughness * waviness(grid, WAVELENGTHS, rng)
        return Variation(weak, (material.toughness * tough).astype(np.float32), displacement)
