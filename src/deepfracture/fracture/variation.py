"""How a material varies in space: smooth, periodic Gaussian random fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepfracture.fracture.lattice import Lattice
from deepfracture.types import Floats32, Material

WAVES = (0.5, 0.25, 0.12)
"""Lengths of the waviness of crack surfaces [m]."""


def random_field(lattice: Lattice, length: float, rng: np.random.Generator) -> Floats32:
    """A periodic Gaussian field of zero mean and unit variance, correlated over `length` [m], shape (n, n, n)."""
    noise = np.fft.rfftn(rng.standard_normal(lattice.shape))
    full = np.fft.fftfreq(lattice.n, lattice.spacing) * 2 * np.pi
    half = np.fft.rfftfreq(lattice.n, lattice.spacing) * 2 * np.pi
    squared = full[:, None, None] ** 2 + full[None, :, None] ** 2 + half[None, None, :] ** 2
    field = np.fft.irfftn(noise * np.exp(-0.25 * squared * length**2), s=lattice.shape, axes=(0, 1, 2))
    field -= field.mean()
    return (field / max(field.std(), 1e-12)).astype(np.float32)


def waviness(lattice: Lattice, lengths: Sequence[float], rng: np.random.Generator) -> Floats32:
    """Superposed fields, each as high as it is long: a self-affine surface over these lengths, unit variance."""
    total = sum(length * random_field(lattice, length, rng) for length in lengths)
    return (total / np.std(total)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Variation:
    """One realisation of the material's randomness on the coarse lattice."""

    strength: Floats32
    """Factor on the strength, shape (m, m, m)."""
    toughness: Floats32
    """[Pa sqrt(m)], shape (m, m, m)."""
    waves: Floats32
    """Displacement of crack sheets along their normal [m], periodic, shape (m, m, m)."""

    @staticmethod
    def draw(material: Material, lattice: Lattice, rng: np.random.Generator) -> Variation:
        weak = np.exp(material.variation_spread * random_field(lattice, material.variation_length, rng))
        tough = np.exp(material.variation_spread * random_field(lattice, material.variation_length, rng))
        waves = material.roughness * waviness(lattice, WAVES, rng)
        return Variation(weak, (material.toughness * tough).astype(np.float32), waves)
