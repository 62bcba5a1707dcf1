"""The sheet on which a crack runs: the zero set of a potential whose gradient follows the greatest tension.

A crack opens across the direction of greatest tension, but that direction is a line field, noisy where the
principal stresses are close. Fitting a potential to it by a weighted Poisson problem gives one smooth sheet
through the seed, globally consistent, without tracking a tangled front of triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.fft import dctn, idctn

from deepfracture.fracture.lattice import Lattice
from deepfracture.types import Floats, Floats32

SWEEPS = 3
"""Rounds in which the signs of the line field and the direction where it is weak are brought in line."""
COHERENCE = 0.8
"""Distance over which a crack remembers the tension at its seed [m]."""


@njit(cache=True)
def _aligned(tension, trust, gradient, wanted):
    """Unit directions between the tension, its sign as the gradient's, and the gradient where tension says little."""
    n = tension.shape[0]
    for i in range(n):
        for j in range(n):
            for k in range(n):
                t, g, share = tension[i, j, k], gradient[i, j, k], trust[i, j, k]
                if t[0] * g[0] + t[1] * g[1] + t[2] * g[2] < 0:
                    share = -share
                x = share * t[0] + (1 - abs(share)) * g[0]
                y = share * t[1] + (1 - abs(share)) * g[1]
                z = share * t[2] + (1 - abs(share)) * g[2]
                length = np.sqrt(x * x + y * y + z * z) + np.float32(1e-6)
                wanted[i, j, k, 0], wanted[i, j, k, 1], wanted[i, j, k, 2] = x / length, y / length, z / length


@njit(cache=True)
def _unit_gradient(potential, gradient):
    """Direction of the potential's gradient, by central differences, one-sided at the border."""
    n = potential.shape[0]
    for i in range(n):
        a, b = max(i - 1, 0), min(i + 1, n - 1)
        for j in range(n):
            c, d = max(j - 1, 0), min(j + 1, n - 1)
            for k in range(n):
                e, f = max(k - 1, 0), min(k + 1, n - 1)
                x = (potential[b, j, k] - potential[a, j, k]) / (b - a)
                y = (potential[i, d, k] - potential[i, c, k]) / (d - c)
                z = (potential[i, j, f] - potential[i, j, e]) / (f - e)
                length = np.sqrt(x * x + y * y + z * z) + 1e-12
                gradient[i, j, k, 0], gradient[i, j, k, 1], gradient[i, j, k, 2] = x / length, y / length, z / length


@njit(cache=True)
def _divergence(direction, spacing, out):
    n = direction.shape[0]
    out[:] = 0
    for i in range(n):
        for j in range(n):
            for k in range(n):
                for axis in range(3):
                    a, b, c = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                    if max(a, b, c) < n:
                        flux = (direction[i, j, k, axis] + direction[a, b, c, axis]) / (2 * spacing)
                        out[i, j, k] += flux
                        out[a, b, c] -= flux


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
        divergence = np.empty(direction.shape[:3], np.float32)
        _divergence(direction, np.float32(self.lattice.spacing), divergence)
        spectrum = np.asarray(dctn(divergence, type=2, norm="ortho")) / -self.eigenvalues
        spectrum[0, 0, 0] = 0
        return np.asarray(idctn(spectrum, type=2, norm="ortho"))

    def sheet(self, tension: Floats32, weight: Floats32, seed: Floats, normal: Floats) -> Floats32:
        """Potential of the sheet through `seed` with about unit slope; zero level not yet shifted.

        tension: unit directions of greatest tension, sign free, (n, n, n, 3).
        weight: how clear that direction is, in [0, 1], (n, n, n).
        seed, normal: where the crack starts [m] and the direction that it opens in, (3,).
        """
        axis = self.lattice.first_centre + self.lattice.spacing * np.arange(self.lattice.n)
        fades = [np.exp(-(((axis - seed[a]) / COHERENCE) ** 2)) for a in range(3)]
        trust = weight * np.einsum("i,j,k->ijk", *fades).astype(np.float32) + np.float32(1e-4)
        gradient, wanted = np.empty_like(tension), np.empty_like(tension)
        gradient[:] = normal
        potential = np.zeros(weight.shape, np.float32)
        for _ in range(SWEEPS):
            _aligned(tension, trust, gradient, wanted)
            potential = self.potential(wanted)
            _unit_gradient(potential, gradient)
        return potential
