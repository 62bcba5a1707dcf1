"""Brittle fracture of a body by one collision, quasi-static in stress, in the order of time.

The elastic solution at peak load fixes the stress. As the load rises linearly, weak or highly stressed places
reach their strength one after the other; each starts a crack that runs over its sheet as long as the stress
intensity beats the toughness, stops at cracks that were there before, and sends out release waves. Places that
a wave reaches before they crack are spared: strong loads, which bring many places to the limit nearly at once,
therefore break a body into more and smaller pieces (Mott 1947; Grady 2006), without a rule that says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.geometry import distance_to_samples
from deepfracture.progress import stage
from deepfracture.types import Floats, Floats32, FracturePattern, Impact

from .body import FractureBody
from .contact import breaks, contacts, tractions
from .elastostatics import solve
from .growth import Crack, Front, Ramp, grow
from .interior import stress_at
from .lattice import MARGIN
from .separate import fragments_of, open_faces
from .sheet import SheetSolver
from .stress import StressState
from .variation import random_field, waviness

MAX_CRACKS = 400
"""A guard, far above what any load reached in tests."""
SPACING_CELLS = 1.6
"""Cracks nearer than this many coarse cells cannot be told apart by the stress field: none starts so close."""
SMALLEST_CELLS = 64
"""Pieces of fewer voxels, a cube of four, are dust and join a neighbour."""
WAVES = (0.5, 0.25, 0.12)
"""Lengths of the waviness of crack surfaces [m]."""


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
    def draw(body: FractureBody, rng: np.random.Generator) -> Variation:
        material = body.material
        weak = np.exp(material.variation_spread * random_field(body.coarse, material.variation_length, rng))
        tough = np.exp(material.variation_spread * random_field(body.coarse, material.variation_length, rng))
        waves = material.roughness * waviness(body.coarse, WAVES, rng)
        return Variation(weak, (material.toughness * tough).astype(np.float32), waves)


@dataclass(frozen=True, eq=False)
class Cracking:
    """How a simulated collision went: the pattern and the cracks that made it."""

    pattern: FracturePattern
    cracks: int
    """Cracks that opened."""
    tension: float
    """Greatest driving stress over local strength at peak load."""


def simulate(body: FractureBody, impact: Impact, rng: np.random.Generator) -> Cracking | None:
    """Break `body` by `impact`; None if the paper's criterion is not met or nothing comes apart.

    `rng` draws the material's variation in space: the same generator state gives the same fragments."""
    if not breaks(impact, body.material, body.area):
        return None
    variation = Variation.draw(body, rng)
    with stage("elastostatics"):
        state, ramp = _load(body, impact, variation)
    tension = float((state.tension / state.strength).max())
    with stage("cracks"):
        cut, faces, count = _crack(body, state, ramp, variation, rng)
    with stage("fragments"):
        pattern = _pattern(body, cut, faces)
    return Cracking(pattern, count, tension) if pattern.count > 1 else None


def _load(body: FractureBody, impact: Impact, variation: Variation) -> tuple[StressState, Ramp]:
    """The elastic answer to the collision at peak load."""
    contact = contacts(impact, body.material)[0]
    solution = solve(body.elastic, tractions(impact, body.material, body.elastic.mesh))
    stress = stress_at(solution, body.nodes)
    strength = body.material.strength * variation.strength[tuple(body.cells.T)].astype(float)
    ramp = Ramp(rise=contact.time / 2, speed=body.material.rayleigh_speed, longest=1.0)
    return StressState.under_load(body, stress, strength, ramp.rise), ramp


def _crack(
    body: FractureBody, state: StressState, ramp: Ramp, variation: Variation, rng: np.random.Generator
) -> tuple[np.ndarray, Floats, int]:
    """Open cracks in the order of their onset until no place is left at its strength."""
    front, sheets = Front.on(body.fine), SheetSolver.on(body.coarse)
    cut = np.zeros(body.sdf.shape, np.uint8)
    position = np.zeros(body.sdf.shape, np.int32)
    closest = SPACING_CELLS * body.coarse.spacing
    faces: list[Floats] = []
    while len(faces) < MAX_CRACKS:
        node = int(state.onset.argmin())
        if not np.isfinite(state.onset[node]):
            break
        seed = body.nodes[node] + 0.2 * body.coarse.spacing * rng.standard_normal(3)
        sheet = _sheet(body, state, sheets, variation, node, seed, rng)
        crack = grow(
            front, body.sdf, body.wall, state.voigt_field(), sheet, variation.toughness,
            seed=seed, start=float(state.onset[node]), fine=body.fine, coarse=body.coarse, ramp=ramp,
        )  # fmt: skip
        state.exhaust(body.nodes[node], closest)
        faces.append(open_faces(crack, front, cut, position))
        _settle(body, state, front, crack, seed, closest=closest, speed=ramp.speed)
    return cut, np.concatenate(faces) if faces else np.zeros((0, 8)), len(faces)


def _sheet(
    body: FractureBody, state: StressState, sheets: SheetSolver, variation: Variation,
    node: int, seed: Floats, rng: np.random.Generator,
) -> Floats32:  # fmt: skip
    """The wavy sheet through `seed`, its potential zero there."""
    weight = state.clarity * np.clip(state.tension / state.strength, 0, 1)
    potential = sheets.sheet(state.field(state.direction), state.field(weight), seed, state.direction[node])
    shift = rng.integers(0, body.coarse.n, 3)
    wavy = potential + np.roll(variation.waves, shift, axis=(0, 1, 2))
    index = tuple(np.round((seed - body.coarse.first_centre) / body.coarse.spacing).astype(int))
    here = tuple(np.clip(index, 0, body.coarse.n - 1))
    return (wavy - wavy[here]).astype(np.float32)


def _settle(
    body: FractureBody, state: StressState, front: Front, crack: Crack, seed: Floats, *, closest: float, speed: float
) -> None:
    """Let the opened crack relieve the stress, and clear the scratch fields."""
    cells = tuple(crack.voxels.T)
    within = (np.abs(crack.offset) < 0.6 * body.fine.spacing) & (body.sdf[cells] > 0)
    if within.any():
        points = body.fine.first_centre + body.fine.spacing * crack.voxels[within].astype(float)
        size = float(np.sqrt(((points - seed) ** 2).sum(1).max()))
        state.relieve(
            points, crack.normals[within], crack.arrival[within], size=max(size, closest), speed=speed, closest=closest
        )
        front.broken[tuple(crack.voxels[within].T)] = 1
    front.status[cells] = 0
    front.arrival[cells] = 0
    front.mouth[cells] = 0
    front.drive[cells] = 0


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
