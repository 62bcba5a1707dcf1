"""The cracks of one collision: they start where the stress reaches the strength, run, and change the stress."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from deepfracture.fracture.body import FractureBody
from deepfracture.fracture.fragments import cut_faces
from deepfracture.fracture.growth import LoadRamp, MarchFields, MarchState, grow
from deepfracture.fracture.level_set import LevelSetSolver
from deepfracture.fracture.mechanisms import Mechanisms
from deepfracture.fracture.pending_faces import PendingFaces
from deepfracture.fracture.stress import StressState
from deepfracture.fracture.variation import Variation
from deepfracture.runtime.progress import StageTimer
from deepfracture.types import Floats, Floats32

MAX_CRACKS = 400
"""A safeguard, far above the number that any load reached in tests."""
MIN_SPACING = 1.6
"""Least distance of a new crack to others [coarse cells]: the stress field cannot resolve closer ones."""
LOAD_STEPS = 10
"""Steps in which the load rises to its peak."""
MAX_IDLE_STEPS = 3
"""Steps without a new crack, after the peak, that end the simulation."""


@dataclass(eq=False)
class Cracks:
    """The cracks of one collision."""

    body: FractureBody
    state: StressState
    variation: Variation
    rng: np.random.Generator
    march: MarchState
    level_sets: LevelSetSolver
    position: np.ndarray
    """Index of each voxel in the current crack, on the fine grid."""
    cut: list[Floats]
    """Faces of the fine grid that each crack has cut, see `cut_faces`."""
    pending: PendingFaces
    mechanisms: Mechanisms
    count: int = 0
    tension: float = 0.0
    """Greatest driving stress over local strength, extrapolated to peak load in the uncracked body."""
    timer: StageTimer = field(default_factory=StageTimer)

    @staticmethod
    def on(
        body: FractureBody, state: StressState, variation: Variation, rng: np.random.Generator, mechanisms: Mechanisms
    ) -> Cracks:
        """No crack yet."""
        march, level_sets = MarchState.on(body.fine), LevelSetSolver.on(body.coarse)
        position, pending = np.zeros(body.sdf.shape, np.int32), PendingFaces.none(state.solid)
        return Cracks(body, state, variation, rng, march, level_sets, position, [], pending, mechanisms)

    @property
    def faces(self) -> Floats:
        return np.concatenate(self.cut) if self.cut else np.zeros((0, 8))

    def run(self) -> None:
        """Load and unload in small steps, and open the cracks that are due in each."""
        state, idle = self.state, 0
        step = state.load.rise / LOAD_STEPS
        while state.time < state.load.end - 0.5 * step and self.count < MAX_CRACKS:
            with self.timer("cracks: stress"):
                if self.mechanisms.release:
                    self.pending = self.pending.open_due(state.solid, state.time + step)
                state.advance(step)
            if not self.count:
                current = float((state.tension / state.strength).max())
                self.tension = max(self.tension, current / state.load.factor(state.time))
            idle = 0 if self._start_due() else idle + 1
            if state.time > state.load.rise and idle > MAX_IDLE_STEPS:
                break
        self.timer.record()

    def _start_due(self) -> int:
        """Open the cracks of the last step, the earliest first. Returns how many."""
        before = self.count
        while self.count < MAX_CRACKS:
            cell = int(self.state.onset.argmin())
            if not np.isfinite(self.state.onset[cell]):
                break
            self._open(cell)
        return self.count - before

    def _open(self, cell: int) -> None:
        body, state = self.body, self.state
        radius = MIN_SPACING * body.coarse.spacing
        seed = body.centres[cell] + 0.2 * body.coarse.spacing * self.rng.standard_normal(3)
        with self.timer("cracks: level sets"):
            level_set = self._level_set(cell, seed)
        ramp = LoadRamp(rise=state.load.rise, speed=body.material.rayleigh_speed, max_length=1.0)
        thickness = body.thickness if self.mechanisms.mouth else np.full_like(body.thickness, 1e-6)
        with self.timer("cracks: fronts"):
            fields = MarchFields(body.sdf, thickness, state.at_peak(), level_set, self.variation.toughness)
            start = float(state.onset[cell])
            crack = grow(self.march, fields, ramp, seed=seed, start=start, fine=body.fine, coarse=body.coarse)
        state.exclude_near(seed[None], radius)
        state.onset[cell] = np.inf
        self.cut.append(cut_faces(crack, self.march, self.position))
        self.pending = self.pending.add(body, crack, self.march, self.position)
        self.count += 1
        on_surface = np.abs(crack.offset) < 0.6 * body.fine.spacing
        within = on_surface & (body.sdf[tuple(crack.voxels.T)] > 0)
        if within.any():
            points = body.fine.first_centre + body.fine.spacing * crack.voxels[within].astype(float)
            state.exclude_near(points, radius)
        self.march.clear(crack)

    def _level_set(self, cell: int, seed: Floats) -> Floats32:
        """The potential of the wavy crack surface through `seed`, zero there [m]."""
        state, coarse = self.state, self.body.coarse
        weight = state.principal_gap * np.clip(state.tension / state.strength, 0, 1)
        potential = self.level_sets.fit(
            state.on_grid(state.direction), state.on_grid(weight), seed, state.direction[cell]
        )
        shift = self.rng.integers(0, coarse.n, 3)
        wavy = potential + np.roll(self.variation.waviness, shift, axis=(0, 1, 2))
        index = tuple(np.round((seed - coarse.first_centre) / coarse.spacing).astype(int))
        here = tuple(np.clip(index, 0, coarse.n - 1))
        return (wavy - wavy[here]).astype(np.float32)
