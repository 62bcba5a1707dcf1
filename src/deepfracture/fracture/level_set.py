"""The surface on which a crack runs: the zero level set of a potential whose gradient follows the greatest tension.

A crack opens across the direction of greatest tension, but that direction is a line field, noisy where the
principal stresses are close. Fitting a potential to it by a Poisson problem gives one smooth surface through the seed,
globally consistent, without tracking a tangled front of triangles. The fit alternates two steps: orient the line
field along the current gradient, blended with that gradient where the field is unclear, and solve

    ∇²φ = div d,   ∂φ/∂n = d.n at the border,

which minimises ∫ |∇φ - d|² for the oriented directions d. Global fits of crack paths as level sets of a potential go
back to the linear scalar field method of crack tracking (Oliver et al. 2004); here the field is not that of a heat
conduction problem but the gradient itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.fft import dctn, idctn

from deepfracture.fracture.padded_grid import PaddedGrid
from deepfracture.types import Floats, Floats32

ITERATIONS = 3
"""Alternations of orienting the line field and solving for the potential."""
CORRELATION_LENGTH = 0.8
"""Distance from the seed over which the directions of tension guide the surface [m]."""


@njit(cache=True)
def _orient(tension, weights, gradient, target):
    """Unit directions of the tension, signed along the gradient, blended with the gradient where weights are small."""
    n = tension.shape[0]
    for i in range(n):
        for j in range(n):
            for k in range(n):
                t, g, w = tension[i, j, k], gradient[i, j, k], weights[i, j, k]
                if t[0] * g[0] + t[1] * g[1] + t[2] * g[2] < 0:
                    w = -w
                x = w * t[0] + (1 - abs(w)) * g[0]
                y = w * t[1] + (1 - abs(w)) * g[1]
                z = w * t[2] + (1 - abs(w)) * g[2]
                length = np.sqrt(x * x + y * y + z * z) + np.float32(1e-6)
                target[i, j, k, 0], target[i, j, k, 1], target[i, j, k, 2] = x / length, y / length, z / length


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
class LevelSetSolver:
    """Poisson's equation on the coarse grid with natural boundary conditions, by cosine transforms."""

    grid: PaddedGrid
    eigenvalues: Floats32

    @staticmethod
    def on(grid: PaddedGrid) -> LevelSetSolver:
        axis = 2 - 2 * np.cos(np.pi * np.arange(grid.n) / grid.n)
        total = (axis[:, None, None] + axis[None, :, None] + axis[None, None, :]) / grid.spacing**2
        total[0, 0, 0] = 1.0
        return LevelSetSolver(grid, total.astype(np.float32))

    def potential(self, direction: Floats32) -> Floats32:
        """The potential whose gradient is closest to `direction` (n, n, n, 3) in the least-squares sense."""
        divergence = np.empty(direction.shape[:3], np.float32)
        _divergence(direction, np.float32(self.grid.spacing), divergence)
        spectrum = np.asarray(dctn(divergence, type=2, norm="ortho")) / -self.eigenvalues
        spectrum[0, 0, 0] = 0
        return np.asarray(idctn(spectrum, type=2, norm="ortho"))

    def fit(self, tension: Floats32, weight: Floats32, seed: Floats, normal: Floats) -> Floats32:
        """Potential [m] whose level set through `seed` is the crack surface, with about unit slope; up to a constant.

        tension: unit directions of greatest tension, sign free, (n, n, n, 3).
        weight: confidence in that direction, in [0, 1], (n, n, n).
        seed, normal: where the crack starts [m], and its opening direction, (3,).
        """
        axis = self.grid.first_centre + self.grid.spacing * np.arange(self.grid.n)
        fades = [np.exp(-(((axis - seed[a]) / CORRELATION_LENGTH) ** 2)) for a in range(3)]
        weights = weight * np.einsum("i,j,k->ijk", *fades).astype(np.float32) + np.float32(1e-4)
        gradient, target = np.empty_like(tension), np.empty_like(tension)
        gradient[:] = normal
        potential = np.zeros(weight.shape, np.float32)
        for _ in range(ITERATIONS):
            _orient(tension, weights, gradient, target)
            potential = self.potential(target)
            _unit_gradient(potential, gradient)
        return potential
