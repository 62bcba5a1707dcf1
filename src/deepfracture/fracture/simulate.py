"""Brittle fracture of a body by one collision.

Boundary elements give the stress of the uncracked body, in proportion to the load. Cracks start where the stress
reaches the local strength; they change the stress (finite elements, in small time steps), the load shifts elsewhere,
and so on until the bodies separate and the strength is exceeded nowhere. Strong loads reach the strength in many places
before a release wave arrives, and therefore break a body into more and smaller fragments (Mott 1947; Grady 2006),
without an explicit rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.fracture.body import FractureBody
from deepfracture.fracture.contact import breaks, contacts, tractions
from deepfracture.fracture.cracked_solid import CrackedSolid
from deepfracture.fracture.cracks import Cracks
from deepfracture.fracture.elastostatics import solve
from deepfracture.fracture.fragments import label_fragments
from deepfracture.fracture.interior import stress_at
from deepfracture.fracture.mechanisms import Mechanisms
from deepfracture.fracture.padded_grid import MARGIN
from deepfracture.fracture.stress import LoadPulse, StressState
from deepfracture.fracture.variation import Variation
from deepfracture.geometry import distance_to_oriented_points
from deepfracture.runtime.progress import stage
from deepfracture.types import Floats, FracturePattern, Impact

MIN_FRAGMENT_VOXELS = 64
"""Components of fewer voxels, a cube of side four, are merged into a neighbour."""


@dataclass(frozen=True, eq=False)
class FractureResult:
    """Result of a simulated collision: the pattern and the cracks that formed it."""

    pattern: FracturePattern
    cracks: int
    """Number of cracks."""
    tension: float
    """Greatest driving stress over local strength at peak load."""


def simulate(
    body: FractureBody, impact: Impact, rng: np.random.Generator, *, mechanisms: Mechanisms | None = None
) -> FractureResult | None:
    """Break `body` by `impact`; None if the paper's criterion is not met or the body stays in one piece.

    `rng` draws the material's variation in space: the same generator state gives the same fragments. `mechanisms`
    switches parts of the mechanics off (default: none)."""
    if not breaks(impact, body.material, body.area):
        return None
    mechanisms = mechanisms or Mechanisms()
    variation = Variation.draw(body.material, body.coarse, rng)
    with stage("elastostatics"):
        state = _initial_state(body, impact, variation, contact=mechanisms.contact)
    with stage("cracks"):
        cracks = Cracks.on(body, state, variation, rng, mechanisms)
        cracks.run()
    with stage("fragments"):
        pattern = _pattern(body, cracks.march.cut, cracks.faces)
    return FractureResult(pattern, cracks.count, cracks.tension) if pattern.count > 1 else None


def _initial_state(body: FractureBody, impact: Impact, variation: Variation, *, contact: bool) -> StressState:
    """The uncracked body at first contact."""
    rise = contacts(impact, body.material)[0].duration / 2
    solution = solve(body.elastic, tractions(impact, body.material, body.elastic.mesh))
    material, inside = body.material, np.zeros(body.coarse.shape, bool)
    inside[tuple(body.cells.T)] = True
    solid = CrackedSolid.on(
        inside, spacing=body.coarse.spacing, young=material.young, poisson=material.poisson,
        density=material.density, contact=contact,
    )  # fmt: skip
    strength = material.strength * variation.strength[tuple(body.cells.T)].astype(float)
    return StressState(body, LoadPulse(rise), strength, stress_at(solution, body.centres), solid)


def _pattern(body: FractureBody, cut: np.ndarray, faces: Floats) -> FracturePattern:
    """Labels on the grid, and the distance to the cut faces that separate two fragments."""
    labels = label_fragments(body.sdf > 0, cut, MIN_FRAGMENT_VOXELS)
    index = faces[:, :3].astype(int)
    axis = faces[:, 3].astype(int)
    beyond = index + np.eye(3, dtype=int)[axis]
    separates = labels[tuple(index.T)] != labels[tuple(beyond.T)]
    separates &= (labels[tuple(index.T)] > 0) & (labels[tuple(beyond.T)] > 0)
    where = index[separates] + np.eye(3)[axis[separates]] * faces[separates, 4, None]
    points = body.fine.first_centre + body.fine.spacing * where
    inner = (slice(MARGIN, -MARGIN),) * 3
    distance = distance_to_oriented_points(body.grid, points, faces[separates, 5:])
    return FracturePattern(body.grid, labels[inner], distance)
