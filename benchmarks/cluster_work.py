"""Jobs of the workers of cluster.py, in a module that they can import."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deepfracture.dataset import CollisionResult, DatasetSettings, Simulator
from deepfracture.dataset.watchdog import collision_seed
from deepfracture.types import FracturePattern, Grid, Impact

POISONED = {1: "raises", 4: "hangs", 6: "takes memory"}
"""Collisions that go wrong, and how."""


@dataclass(frozen=True)
class Busy:
    """Collisions that take `seconds` of one processor each, or of the clock alone, and nothing else."""

    seconds: float
    waits: bool

    def __call__(self, settings: DatasetSettings) -> Simulator:
        grid = Grid(settings.resolution)

        def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
            clock = time.monotonic if self.waits else time.process_time
            until = clock() + self.seconds
            while clock() < until:
                if self.waits:
                    time.sleep(0.01)
                else:
                    np.linalg.svd(np.ones((60, 60)))
            direction = np.array([[1.0, 0.0, 0.0]])
            impact = Impact(rng.uniform(-1, 1, (1, 3)), direction, np.array([rng.uniform(1, 9)]), -direction, 3.0, 0.2)
            labels = np.repeat(rng.integers(1, 5, (2, *grid.shape[1:])), grid.resolution // 2, axis=0)
            distance = rng.uniform(0, 1, grid.shape).astype(np.float16).astype(np.float32)
            return CollisionResult(impact, FracturePattern(grid, labels.astype(np.int32), distance))

        return collide


@dataclass(frozen=True)
class Poisoned:
    """As others, but for the collisions of POISONED."""

    healthy: Callable[[DatasetSettings], Simulator]

    def __call__(self, settings: DatasetSettings) -> Simulator:
        collide = self.healthy(settings)
        states = {_state(np.random.default_rng(collision_seed(settings.seed, k))): how for k, how in POISONED.items()}

        def poisoned(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
            how = states.get(_state(rng))
            if how == "raises":
                raise ArithmeticError("the solver divided by zero")
            if how == "hangs":
                time.sleep(3600)
            if how == "takes memory":
                kept = [np.ones(1 << 24) for _ in range(60)]
                time.sleep(3600 + len(kept))
            return collide(rng, again)

        return poisoned


def _state(rng: np.random.Generator) -> int:
    return rng.bit_generator.state["state"]["state"]
