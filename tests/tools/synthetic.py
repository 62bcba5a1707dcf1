"""Collisions that cost nothing and stand in for world and simulator; light, as every worker process imports this."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

from deepfracture.dataset import CollisionResult, DatasetSettings, Sample
from deepfracture.dataset.watchdog import collision_seed
from deepfracture.types import FracturePattern, Grid, Impact, Material, Mesh, NoSolution, Shape

CLAY = Material("clay", 40e9, 0.2, 2200.0, 28e6, 0.9e6, 10.0)
TETRAHEDRON = Shape(
    "tetrahedron",
    Mesh([[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


def random_sample(rng: np.random.Generator, resolution: int = 32) -> Sample:
    direction = rng.normal(size=(2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    magnitude = np.sort(rng.uniform(1, 100, 2))[::-1]
    impact = Impact(rng.uniform(-1, 1, (2, 3)), direction, magnitude, -direction, float(rng.uniform(1, 9)), 0.2)
    grid = Grid(resolution)
    labels = np.repeat(rng.integers(0, 5, (2, *grid.shape[1:])), resolution // 2, axis=0)
    distance = rng.uniform(0, 1, grid.shape).astype(np.float16)
    return Sample(impact, FracturePattern(grid, labels, distance), int(rng.integers(1 << 60)))


def fake_collisions(settings: DatasetSettings):
    """Stands in for world and simulator: a third of the balls break nothing, some miss."""

    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
        kind = rng.integers(6)
        sample = random_sample(rng, settings.resolution)
        return CollisionResult(None if kind == 0 else sample.impact, None if kind < 2 else sample.pattern)

    return collide


def failing_collisions(settings: DatasetSettings):
    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
        raise ZeroDivisionError("ball: too round")

    return collide


def unready(settings: DatasetSettings):
    raise ZeroDivisionError("oven: too cold")


def poisoned_collisions(settings: DatasetSettings):
    """As `fake_collisions`, but one hangs, one eats all memory, one dies and one raises."""
    simple = fake_collisions(settings)
    seeds = [collision_seed(settings.seed, k) for k in range(4)]
    starts = [np.random.default_rng(seed).bit_generator.state["state"]["state"] for seed in seeds]

    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
        start = rng.bit_generator.state["state"]["state"]
        if start == starts[0]:
            time.sleep(1000)
        if start == starts[1]:
            eaten = np.ones(100_000_000)  # 0.8 GB
            time.sleep(1000 + eaten[0])
        if start == starts[2]:
            os.kill(os.getpid(), signal.SIGKILL)
        if start == starts[3]:
            raise IndexError("out of plates")
        return simple(rng)

    return collide


def killed_once(settings: DatasetSettings):
    """As `fake_collisions`, but the first worker that comes to the third collision is killed in it."""
    simple = fake_collisions(settings)
    third = np.random.default_rng(collision_seed(settings.seed, 2)).bit_generator.state["state"]["state"]

    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
        trace = Path(settings.material.name)
        if rng.bit_generator.state["state"]["state"] == third and not trace.exists():
            trace.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return simple(rng)

    return collide


def stubborn_collisions(settings: DatasetSettings):
    """As `fake_collisions`, but every fourth or so cannot be solved."""
    simple = fake_collisions(settings)

    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
        if rng.random() < 0.25:
            raise NoSolution("the stress did not converge")
        return simple(rng)

    return collide


def repeated_collisions(settings: DatasetSettings):
    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
        impact = random_sample(rng, settings.resolution).impact
        return CollisionResult(impact, random_sample(again or rng, settings.resolution).pattern)

    return collide
