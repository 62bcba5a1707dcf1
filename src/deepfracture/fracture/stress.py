"""The stress that cracks feel, as the load of a collision comes and goes and the cracks let go of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from scipy.spatial import KDTree

from deepfracture.fracture.body import FractureBody
from deepfracture.fracture.cracked import CrackedSolid
from deepfracture.types import Floats, Floats32

SWEEPS = 12
"""Rounds of Jacobi's rotations; five reach double precision."""


@njit(cache=True)
def principal(stress):
    """Principal stresses (n, 3), rising, and the direction of the greatest, (n, 3), of stresses (n, 6): xx, yy, zz,
    yz, xz, xy. Jacobi's rotations: many small matrices, each in registers."""
    values, directions = np.empty((len(stress), 3)), np.empty((len(stress), 3))
    a, v = np.empty((3, 3)), np.empty((3, 3))
    for q in range(len(stress)):
        for i in range(3):
            for j in range(3):
                a[i, j] = stress[q, i] if i == j else stress[q, 6 - i - j]
                v[i, j] = 1.0 if i == j else 0.0
        for _ in range(SWEEPS):
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
class Load:
    """How the contact force comes and goes: linearly to its peak and back, a triangle for Hertz's bell."""

    rise: float
    """Time from first contact to peak load [s]."""

    @property
    def end(self) -> float:
        """When the bodies part [s]."""
        return 2 * self.rise

    def share(self, time: float) -> float:
        """Of the peak load, in [0, 1]."""
        return max(0.0, 1 - abs(time / self.rise - 1))


@dataclass(eq=False)
class StressState:
    """Driving stress at the nodes of the coarse lattice, and which of them start a crack."""

    body: FractureBody
    load: Load
    strength: Floats
    """Local tensile strength [Pa], shape (n,)."""
    elastic: Floats
    """Stress of the uncracked body at peak load [Pa], shape (n, 6)."""
    solid: CrackedSolid
    time: float = 0.0
    """[s] since first contact"""
    stress: Floats = field(init=False)
    """Driving stress now: sigma plus what compression adds [Pa], shape (n, 6): xx, yy, zz, yz, xz, xy."""
    tension: Floats = field(init=False)
    """Greatest principal value of `stress` [Pa], shape (n,)."""
    direction: Floats = field(init=False)
    """Its direction, shape (n, 3)."""
    clarity: Floats = field(init=False)
    """How far it exceeds the next one, in [0, 1], shape (n,)."""
    onset: Floats = field(init=False)
    """When a crack starts here, in the last step [s], inf: it does not, shape (n,)."""
    taken: np.ndarray = field(init=False)
    """Nodes so near to a crack that none may start there, shape (n,)."""

    def __post_init__(self) -> None:
        n = len(self.strength)
        self.tension, self.onset = np.zeros(n), np.full(n, np.inf)
        self.taken = np.zeros(n, bool)
        self._refresh()

    def advance(self, step: float) -> None:
        """Let `step` seconds pass: the load changes, cracks that have opened let go, waves run."""
        before, since = self.tension / self.strength, self.time
        self.time += step
        self.solid.advance(self.load.share(self.time) * self.elastic, step)
        self._refresh()
        after = self.tension / self.strength
        passed = (1 - before) / np.maximum(after - before, 1e-9)  # share of the step in which the limit is reached
        self.onset = np.where((after >= 1) & ~self.taken, since + step * np.clip(passed, 0, 1), np.inf)

    def _refresh(self) -> None:
        """Principal values of the driving stress.

        Compression drives wing cracks along its direction: in the Coulomb-Mohr criterion
        sigma_1 / S_t - sigma_3 / S_c >= 1, so -sigma_3 / compressive_factor acts like a tension."""
        self.stress = self.load.share(self.time) * self.elastic + self.solid.stress()
        values, self.direction = principal(self.stress)
        push = np.maximum(-values[:, 0], 0) / self.body.material.compressive_factor
        self.stress[:, :3] += push[:, None]
        self.tension = values[:, 2] + push
        top = np.maximum(self.tension, 1e-9)
        self.clarity = np.clip((values[:, 2] - values[:, 1]) / top, 0, 1)

    def field(self, values: Floats) -> Floats32:
        """Node values (n, ...) on the whole coarse lattice, continued outside by the nearest node."""
        return values[self.body.node_of].astype(np.float32)

    def at_peak(self) -> Floats32:
        """Driving stress as it will be at peak load if nothing else cracks, shape (6, m, m, m)."""
        share = self.load.share(self.time) if self.time < self.load.rise else 1.0
        return np.ascontiguousarray(np.moveaxis(self.field(self.stress / share), -1, 0))

    def crowd(self, points: Floats, closest: float) -> None:
        """No crack starts nearer than `closest` [m] to `points` (k, 3) any more."""
        distance, _ = KDTree(points).query(self.body.nodes, distance_upper_bound=closest)
        near = np.isfinite(distance)
        self.taken |= near
        self.onset[near] = np.inf
