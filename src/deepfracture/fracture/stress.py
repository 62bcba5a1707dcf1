"""The stress that cracks feel: at the nodes of the coarse lattice, relieved by every crack that opens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from deepfracture.types import Floats, Floats32

from .body import FractureBody

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def tensors(voigt: Floats) -> Floats:
    """(n, 6) -> (n, 3, 3)."""
    full = np.empty((len(voigt), 3, 3))
    for q, (a, b) in enumerate(VOIGT):
        full[:, a, b] = full[:, b, a] = voigt[:, q]
    return full


def voigt(full: Floats) -> Floats:
    """(n, 3, 3) -> (n, 6)."""
    return np.stack([full[:, a, b] for a, b in VOIGT], axis=1)


@dataclass(eq=False)
class StressState:
    """Driving stress at the nodes, and when each node would start a crack. Changes as cracks open."""

    body: FractureBody
    strength: Floats
    """Local tensile strength [Pa], shape (n,)."""
    rise: float
    """Time from first contact to peak load [s]."""
    stress: Floats
    """Driving stress at peak load [Pa]: sigma plus what compression adds, shape (n, 3, 3)."""
    tension: Floats
    """Greatest principal value of `stress` [Pa], shape (n,)."""
    direction: Floats
    """Its direction, shape (n, 3)."""
    clarity: Floats
    """How far it exceeds the next one, in [0, 1], shape (n,)."""
    onset: Floats
    """When a crack starts here [s], inf: never, shape (n,)."""

    @staticmethod
    def under_load(body: FractureBody, stress: Floats, strength: Floats, rise: float) -> StressState:
        """From the elastic solution `stress` (n, 6) [Pa] at peak load.

        Compression drives wing cracks along its direction: in the Coulomb-Mohr criterion
        sigma_1 / S_t - sigma_3 / S_c >= 1, so -sigma_3 / compressive_factor acts like a tension."""
        full = tensors(stress)
        least = np.linalg.eigvalsh(full)[:, 0]
        full += (np.maximum(-least, 0) / body.material.compressive_factor)[:, None, None] * np.eye(3)
        n = len(full)
        state = StressState(body, strength, rise, full, np.zeros(n), np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf))
        state._refresh(np.arange(n), np.zeros(n))
        return state

    def _refresh(self, nodes: np.ndarray, earliest: Floats) -> None:
        """Principal values and onset of `nodes`, none before `earliest`: the load rises linearly until `rise`."""
        values, vectors = np.linalg.eigh(self.stress[nodes])
        self.tension[nodes] = values[:, 2]
        self.direction[nodes] = vectors[:, :, 2]
        top = np.maximum(values[:, 2], 1e-9)
        self.clarity[nodes] = np.clip((values[:, 2] - values[:, 1]) / top, 0, 1)
        share = self.strength[nodes] / top
        self.onset[nodes] = np.where(share <= 1, np.maximum(share * self.rise, earliest), np.inf)

    def field(self, values: Floats) -> Floats32:
        """Node values (n, ...) on the whole coarse lattice, continued outside by the nearest node."""
        return values[self.body.node_of].astype(np.float32)

    def voigt_field(self) -> Floats32:
        """Driving stress on the coarse lattice, shape (6, m, m, m)."""
        return np.ascontiguousarray(np.moveaxis(self.field(voigt(self.stress)), -1, 0))

    def relieve(
        self, points: Floats, normals: Floats, arrival: Floats, *, size: float, speed: float, closest: float
    ) -> None:
        """A crack opened: release waves run from it at `speed` and unload what has not yet cracked (Mott 1947).

        points, normals (k, 3), arrival (k,) [s]: where, how and when it opened. The stress across the crack
        vanishes beside it and returns over a distance of its `size` (Saint-Venant). A node whose own crack
        starts before the wave is there is not stopped by it. Nodes nearer than `closest` start none."""
        found = KDTree(points).query(self.body.nodes, distance_upper_bound=2 * size)
        distance, index = (np.asarray(part) for part in found)
        near = np.isfinite(distance)
        wave = np.full(len(distance), np.inf)
        wave[near] = arrival[index[near]] + distance[near] / speed
        late = np.flatnonzero(near & (self.onset > wave))
        normal = normals[index[late]]
        across = np.einsum("ni,nij,nj->n", normal, self.stress[late], normal)
        weight = np.where(across > 0, np.exp(-((distance[late] / size) ** 2)), 0.0)
        keep = np.eye(3) - weight[:, None, None] * normal[:, :, None] * normal[:, None, :]
        self.stress[late] = keep @ self.stress[late] @ keep
        spent = np.isinf(self.onset[late]) & (self.tension[late] >= self.strength[late])
        self._refresh(late, wave[late])
        self.onset[late[spent]] = np.inf
        self.onset[distance < closest] = np.inf

    def exhaust(self, seed: Floats, radius: float) -> None:
        """No crack starts within `radius` of `seed` any more."""
        self.onset[((self.body.nodes - seed) ** 2).sum(1) < radius**2] = np.inf
