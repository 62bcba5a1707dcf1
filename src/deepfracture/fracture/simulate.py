"""Brittle fracture of a body by one collision.

Boundary elements give the stress of the uncracked body, which follows the load as it comes and goes. Places that
reach their strength start cracks; cracks change the stress (finite elements, by small steps in time), other places
take the load over, and so on until the bodies part and nothing exceeds its strength. Strong loads bring many
places to the limit before a release wave has come by, and therefore break a body into more and smaller pieces
(Mott 1947; Grady 2006), without a rule that says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.fracture.body import FractureBody
from deepfracture.fracture.contact import breaks, contacts, tractions
from deepfracture.fracture.cracked import CrackedSolid
from deepfracture.fracture.cracks import Cracks
from deepfracture.fracture.elastostatics import solve
from deepfracture.fracture.interior import stress_at
from deepfracture.fracture.lattice import MARGIN
from deepfracture.fracture.mechanisms import Mechanisms
from deepfracture.fracture.separate import fragments_of
from deepfracture.fracture.stress import Load, StressState
from deepfracture.fracture.variation import Variation
from deepfracture.geometry import distance_to_samples
from deepfracture.runtime.progress import stage
from deepfracture.types import Floats, FracturePattern, Impact

SMALLEST_CELLS = 64
"""Pieces of fewer voxels, a cube of four, are dust and join a neighbour."""


@dataclass(frozen=True, eq=False)
class Cracking:
    """How a simulated collision went: the pattern and the cracks that made it."""

    pattern: FracturePattern
    cracks: int
    """Cracks that opened."""
    tension: float
    """Greatest driving stress over local strength at peak load."""


def simulate(
    body: FractureBody, impact: Impact, rng: np.random.Generator, *, mechanisms: Mechanisms | None = None
) -> Cracking | None:
    """Break `body` by `impact`; None if the paper's criterion is not met or nothing comes apart.

    `rng` draws the material's variation in space: the same generator state gives the same fragments. `mechanisms`
    turns parts of the mechanics off (default: none)."""
    if not breaks(impact, body.material, body.area):
        return None
    mechanisms = mechanisms or Mechanisms()
    variation = Variation.draw(body.material, body.coarse, rng)
    with stage("elastostatics"):
        state = _load(body, impact, variation, contact=mechanisms.contact)
    with stage("cracks"):
        cracks = Cracks.on(body, state, variation, rng, mechanisms)
        cracks.run()
    with stage("fragments"):
        pattern = _pattern(body, cracks.front.cut, cracks.faces)
    return Cracking(pattern, cracks.count, cracks.tension) if pattern.count > 1 else None


def _load(body: FractureBody, impact: Impact, variation: Variation, *, contact: bool) -> StressState:
    """The uncracked body under the collision, before anything has happened."""
    rise = contacts(impact, body.material)[0].time / 2
    solution = solve(body.elastic, tractions(impact, body.material, body.elastic.mesh))
    material, inside = body.material, np.zeros(body.coarse.shape, bool)
    inside[tuple(body.cells.T)] = True
    solid = CrackedSolid.on(
        inside, spacing=body.coarse.spacing, young=material.young, poisson=material.poisson,
        density=material.density, contact=contact,
    )  # fmt: skip
    strength = material.strength * variation.strength[tuple(body.cells.T)].astype(float)
    return StressState(body, Load(rise), strength, stress_at(solution, body.nodes), solid)


def _pattern(body: FractureBody, cut: np.ndarray, faces: Floats) -> FracturePattern:
    """Labels on the grid, and the distance to those faces that really part two fragments."""
    labels = fragments_of(body.sdf > 0, cut, SMALLEST_CELLS)
    index = faces[:, :3].astype(int)
    axis = faces[:, 3].astype(int)
    beyond = index + np.eye(3, dtype=int)[axis]
    parted = labels[tuple(index.T)] != labels[tuple(beyond.T)]
    parted &= (labels[tuple(index.T)] > 0) & (labels[tuple(beyond.T)] > 0)
    where = index[parted] + np.eye(3)[axis[parted]] * faces[parted, 4, None]
    points = body.fine.first_centre + body.fine.spacing * where
    inner = (slice(MARGIN, -MARGIN),) * 3
    distance = distance_to_samples(body.grid, points, faces[parted, 5:])
    return FracturePattern(body.grid, labels[inner], distance)
