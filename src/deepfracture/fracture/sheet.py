"""The sheet on which a crack runs: the zero set of a potential whose gradient follows the greatest tension.

A crack opens across the direction of greatest tension, but that direction is a line field, noisy where the
principal stresses are close. Fitting a potential to it by a weighted Poisson problem gives one smooth sheet
through the seed, globally consistent, without tracking a tangled front of triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import dctn, idctn

from deepfracture.types import Floats, Floats32

from .lattice import Lattice

SWEEPS = 3
"""Rounds in which the signs of the line field and the direction where it is weak are brought in line."""
COHERENCE = 0.8
"""Distance over which a crack remembers the tension at its seed [m]."""


@dataclass(frozen=True, eq=False)
class SheetSolver:
    """Poisson's equation on the coarse lattice with free boundaries, by cosine transforms."""

    lattice: Lattice
    eigenvalues: Floats32

    @staticmethod
    def on(lattice: Lattice) -> SheetSolver:
        axis = 2 - 2 * np.cos(np.pi * np.arange(lattice.n) / lattice.n)
        total = (axis[:, None, None] + axis[None, :, None] + axis[None, None, :]) / lattice.spacing**2
        total[0, 0, 0] = 1.0
        return SheetSolver(lattice, total.astype(np.float32))

    def potential(self, direction: Floats32) -> Floats32:
        """The potential whose gradient is closest to `direction` (n, n, n, 3) in the least-squares sense."""
        divergence = np.zeros(direction.shape[:3], np.float32)
        for axis in range(3):
            component = np.moveaxis(direction[..., axis], axis, 0)
            flux = 0.5 * (component[1:] + component[:-1]) / self.lattice.spacing
            target = np.moveaxis(divergence, axis, 0)
            target[:-1] += flux
            target[1:] -= flux
        spectrum = np.asarray(dctn(divergence, type=2, norm="ortho")) / -self.eigenvalues
        spectrum[0, 0, 0] = 0
        return np.asarray(idctn(spectrum, type=2, norm="ortho"))

    def sheet(self, tension: Floats32, weight: Floats32, seed: Floats, normal: Floats) -> Floats32:
        """Potential of the sheet through `seed` with about unit slope; zero level not yet shifted.

        tension: unit directions of greatest tension, sign free, (n, n, n, 3).
        weight: how clear that direction is, in [0, 1], (n, n, n).
        seed, normal: where the crack starts [m] and the direction that it opens in, (3,).
        """
        away = np.linalg.norm(self.lattice.centres() - seed, axis=-1)
        trust = (weight * np.exp(-((away / COHERENCE) ** 2)) + 1e-4)[..., None].astype(np.float32)
        gradient = np.broadcast_to(normal.astype(np.float32), tension.shape)
        potential = np.zeros(weight.shape, np.float32)
        for _ in range(SWEEPS):
            sign = np.where(np.einsum("ijkc,ijkc->ijk", tension, gradient) < 0, -1, 1)[..., None]
            wanted = trust * sign * tension + (1 - trust) * gradient
            wanted /= np.linalg.norm(wanted, axis=-1, keepdims=True) + 1e-6
            potential = self.potential(wanted.astype(np.float32))
            gradient = np.stack([*np.gradient(potential, self.lattice.spacing)], axis=-1)
            gradient = gradient / (np.linalg.norm(gradient, axis=-1, keepdims=True) + 1e-6)
        return potential
