"""The cracks of one collision: where the stress reaches the strength they start, run, and change the stress."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from deepfracture.fracture.body import FractureBody
from deepfracture.fracture.growth import Front, Ramp, grow
from deepfracture.fracture.mechanisms import Mechanisms
from deepfracture.fracture.openings import Openings
from deepfracture.fracture.separate import open_faces
from deepfracture.fracture.sheet import SheetSolver
from deepfracture.fracture.stress import StressState
from deepfracture.fracture.variation import Variation
from deepfracture.runtime.progress import StageTimer
from deepfracture.types import Floats, Floats32

MAX_CRACKS = 400
"""A guard, far above what any load reached in tests."""
SPACING_CELLS = 1.6
"""Cracks nearer than this many coarse cells cannot be told apart by the stress field: none starts so close."""
STEPS = 10
"""Steps in which the load rises to its peak."""
PATIENCE = 3
"""After the peak, steps without a new crack after which none is waited for."""


@dataclass(eq=False)
class Cracks:
    """The cracks of one collision."""

    body: FractureBody
    state: StressState
    variation: Variation
    rng: np.random.Generator
    front: Front
    sheets: SheetSolver
    position: np.ndarray
    opened: list[Floats]
    pending: Openings
    mechanisms: Mechanisms
    count: int = 0
    tension: float = 0.0
    """Greatest driving stress over local strength that the uncracked body would have seen."""
    time: StageTimer = field(default_factory=StageTimer)

    @staticmethod
    def on(
        body: FractureBody, state: StressState, variation: Variation, rng: np.random.Generator, mechanisms: Mechanisms
    ) -> Cracks:
        """No crack yet."""
        front, sheets, position = Front.on(body.fine), SheetSolver.on(body.coarse), np.zeros(body.sdf.shape, np.int32)
        pending = Openings.none(state.solid)
        return Cracks(body, state, variation, rng, front, sheets, position, [], pending, mechanisms)

    @property
    def faces(self) -> Floats:
        return np.concatenate(self.opened) if self.opened else np.zeros((0, 8))

    def run(self) -> None:
        """Load and unload in small steps, and open the cracks that are due in each."""
        state, idle = self.state, 0
        step = state.load.rise / STEPS
        while state.time < state.load.end - 0.5 * step and self.count < MAX_CRACKS:
            with self.time("cracks: stress"):
                if self.mechanisms.release:
                    self.pending = self.pending.release(state.solid, state.time + step)
                state.advance(step)
            if not self.count:
                now = float((state.tension / state.strength).max())
                self.tension = max(self.tension, now / state.load.share(state.time))
            idle = 0 if self._start_due() else idle + 1
            if state.time > state.load.rise and idle > PATIENCE:
                break
        self.time.record()

    def _start_due(self) -> int:
        """Open the cracks of the last step, the earliest first. Returns how many."""
        before = self.count
        while self.count < MAX_CRACKS:
            node = int(self.state.onset.argmin())
            if not np.isfinite(self.state.onset[node]):
                break
            self._open(node)
        return self.count - before

    def _open(self, node: int) -> None:
        body, state, front = self.body, self.state, self.front
        closest = SPACING_CELLS * body.coarse.spacing
        seed = body.nodes[node] + 0.2 * body.coarse.spacing * self.rng.standard_normal(3)
        with self.time("cracks: sheets"):
            sheet = self._sheet(node, seed)
        ramp = Ramp(rise=state.load.rise, speed=body.material.rayleigh_speed, longest=1.0)
        wall = body.wall if self.mechanisms.mouth else np.full_like(body.wall, 1e-6)
        with self.time("cracks: fronts"):
            crack = grow(
                front, body.sdf, wall, state.at_peak(), sheet, self.variation.toughness,
                seed=seed, start=float(state.onset[node]), fine=body.fine, coarse=body.coarse, ramp=ramp,
            )  # fmt: skip
        state.crowd(seed[None], closest)
        state.onset[node] = np.inf
        self.opened.append(open_faces(crack, front, self.position))
        self.pending = self.pending.add(body, crack, front, self.position)
        self.count += 1
        cells = tuple(crack.voxels.T)
        within = (np.abs(crack.offset) < 0.6 * body.fine.spacing) & (body.sdf[cells] > 0)
        if within.any():
            points = body.fine.first_centre + body.fine.spacing * crack.voxels[within].astype(float)
            state.crowd(points, closest)
        front.clear(crack)

    def _sheet(self, node: int, seed: Floats) -> Floats32:
        """The wavy sheet through `seed`, its potential zero there."""
        state, coarse = self.state, self.body.coarse
        weight = state.clarity * np.clip(state.tension / state.strength, 0, 1)
        potential = self.sheets.sheet(state.field(state.direction), state.field(weight), seed, state.direction[node])
        shift = self.rng.integers(0, coarse.n, 3)
        wavy = potential + np.roll(self.variation.waves, shift, axis=(0, 1, 2))
        index = tuple(np.round((seed - coarse.first_centre) / coarse.spacing).astype(int))
        here = tuple(np.clip(index, 0, coarse.n - 1))
        return (wavy - wavy[here]).astype(np.float32)
