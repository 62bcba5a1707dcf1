"""The stress that drives cracks, while the load of a collision rises and falls and open cracks relieve it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from scipy.spatial import KDTree

from deepfracture.fracture.body import FractureBody
from deepfracture.fracture.cracked_solid import CrackedSolid
from deepfracture.types import Floats, Floats32

MAX_SWEEPS = 12
"""Most sweeps of Jacobi rotations; five reach double precision."""


@njit(cache=True)
def principal(stress):
    """Principal stresses (n, 3), ascending, and the direction of the greatest, (n, 3), of stresses (n, 6): xx, yy, zz,
    yz, xz, xy. By Jacobi rotations (Jacobi 1846): many small matrices, each in registers."""
    values, directions = np.empty((len(stress), 3)), np.empty((len(stress), 3))
    a, v = np.empty((3, 3)), np.empty((3, 3))
    for q in range(len(stress)):
        for i in range(3):
            for j in range(3):
                a[i, j] = stress[q, i] if i == j else stress[q, 6 - i - j]
                v[i, j] = 1.0 if i == j else 0.0
        for _ in range(MAX_SWEEPS):
            off = abs(a[0, 1]) + abs(a[0, 2]) + abs(a[1, 2])
            if off <= 1e-14 * (abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2])):
                break
            for r in range(3):
                i, j = (0, 1) if r == 0 else ((0, 2) if r == 1 else (1, 2))
                if a[i, j] == 0:
                    continue
                slope = (a[j, j] - a[i, i]) / (2 * a[i, j])
                t = (1.0 if slope >= 0 else -1.0) / (abs(slope) + np.sqrt(slope * slope + 1))
                c = 1 / np.sqrt(t * t + 1)
                s = t * c
                for k in range(3):
                    x, y = a[k, i], a[k, j]
                    a[k, i], a[k, j] = c * x - s * y, s * x + c * y
                for k in range(3):
                    x, y = a[i, k], a[j, k]
                    a[i, k], a[j, k] = c * x - s * y, s * x + c * y
                for k in range(3):
                    x, y = v[k, i], v[k, j]
                    v[k, i], v[k, j] = c * x - s * y, s * x + c * y
        top = 0
        for i in range(1, 3):
            if a[i, i] > a[top, top]:
                top = i
        low, high = min(a[0, 0], a[1, 1], a[2, 2]), a[top, top]
        values[q, 0], values[q, 1], values[q, 2] = low, a[0, 0] + a[1, 1] + a[2, 2] - low - high, high
        for k in range(3):
            directions[q, k] = v[k, top]
    return values, directions


@dataclass(frozen=True)
class LoadPulse:
    """The contact force over time: linear to its peak and back, a triangle in place of Hertz's bell."""

    rise: float
    """Time from first contact to peak load [s]."""

    @property
    def end(self) -> float:
        """When the bodies separate [s]."""
        return 2 * self.rise

    def factor(self, time: float) -> float:
        """Load over peak load, in [0, 1]."""
        return max(0.0, 1 - abs(time / self.rise - 1))


@dataclass(eq=False)
class StressState:
    """Driving stress in the cells of the coarse grid, and in which of them a crack starts."""

    body: FractureBody
    load: LoadPulse
    strength: Floats
    """Local tensile strength [Pa], shape (n,)."""
    elastic: Floats
    """Stress of the uncracked body at peak load [Pa], shape (n, 6)."""
    solid: CrackedSolid
    time: float = 0.0
    """[s] since first contact"""
    stress: Floats = field(init=False)
    """Current driving stress: sigma plus the contribution of compression [Pa], shape (n, 6): xx, yy, zz, yz, xz, xy."""
    tension: Floats = field(init=False)
    """Greatest principal value of `stress` [Pa], shape (n,)."""
    direction: Floats = field(init=False)
    """Its direction, shape (n, 3)."""
    principal_gap: Floats = field(init=False)
    """Difference to the second principal stress over `tension`, in [0, 1], shape (n,)."""
    onset: Floats = field(init=False)
    """Time in the last step at which a crack starts [s], inf if none does, shape (n,)."""
    excluded: np.ndarray = field(init=False)
    """Cells too near to a crack for another to start, shape (n,)."""

    def __post_init__(self) -> None:
        n = len(self.strength)
        self.tension, self.onset = np.zeros(n), np.full(n, np.inf)
        self.excluded = np.zeros(n, bool)
        self._update()

    def advance(self, step: float) -> None:
        """Advance by `step` seconds: the load changes, open cracks relieve the stress, waves propagate."""
        before, start = self.tension / self.strength, self.time
        self.time += step
        self.solid.advance(self.load.factor(self.time) * self.elastic, step)
        self._update()
        after = self.tension / self.strength
        fraction = (1 - before) / np.maximum(after - before, 1e-9)  # of the step, when the strength is reached
        self.onset = np.where((after >= 1) & ~self.excluded, start + step * np.clip(fraction, 0, 1), np.inf)

    def _update(self) -> None:
        """Principal values of the driving stress.

        Compression drives wing cracks along its direction: in the Coulomb-Mohr criterion
        sigma_1 / S_t - sigma_3 / S_c >= 1, so -sigma_3 / compressive_factor acts like a tension."""
        self.stress = self.load.factor(self.time) * self.elastic + self.solid.stress()
        values, self.direction = principal(self.stress)
        compression = np.maximum(-values[:, 0], 0) / self.body.material.compressive_factor
        self.stress[:, :3] += compression[:, None]
        self.tension = values[:, 2] + compression
        top = np.maximum(self.tension, 1e-9)
        self.principal_gap = np.clip((values[:, 2] - values[:, 1]) / top, 0, 1)

    def on_grid(self, values: Floats) -> Floats32:
        """Cell values (n, ...) on the whole coarse grid, extrapolated by the nearest cell."""
        return values[self.body.nearest_cell].astype(np.float32)

    def at_peak(self) -> Floats32:
        """Driving stress extrapolated to peak load [Pa], if nothing else cracks, shape (6, m, m, m)."""
        factor = self.load.factor(self.time) if self.time < self.load.rise else 1.0
        return np.ascontiguousarray(np.moveaxis(self.on_grid(self.stress / factor), -1, 0))

    def exclude_near(self, points: Floats, radius: float) -> None:
        """Let no crack start within `radius` [m] of `points` (k, 3)."""
        distance, _ = KDTree(points).query(self.body.centres, distance_upper_bound=radius)
        near = np.isfinite(distance)
        self.excluded |= near
        self.onset[near] = np.inf
