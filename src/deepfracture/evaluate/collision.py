"""One held-out collision: repeated simulations against one another, and every source against them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from deepfracture.breakers import PatternSource
from deepfracture.compare import MEASURES, Descriptors, describe, distances
from deepfracture.dataset import Sample
from deepfracture.runtime.progress import collect_stages
from deepfracture.types import BadInput, FracturePattern, Impact, Ints, Shape

Distances = dict[str, float]
"""By the names of `compare.MEASURES`."""


@dataclass(frozen=True)
class SourceResult:
    """The predictions of one source for one collision, draw by draw."""

    volumes: tuple[tuple[float, ...], ...]
    """Of the fragments [m^3]; a shape that held is one fragment."""
    distances: tuple[Distances, ...]
    """Means over all repeats of the simulation."""
    apart: Distances
    """Mean over the pairs of draws; empty for a single draw."""
    seconds: tuple[float, ...]
    stages: tuple[dict[str, float], ...]
    """Seconds of each stage that the source reports."""

    @property
    def counts(self) -> tuple[int, ...]:
        return tuple(len(volumes) for volumes in self.volumes)


@dataclass(frozen=True)
class HeldOutCollision:
    """One held-out collision."""

    number: int
    """Of the collision in its data set."""
    impulse: float
    """The strongest [N s]."""
    position: tuple[float, ...]
    """[m], body frame."""
    direction: tuple[float, ...]
    volumes: tuple[tuple[float, ...], ...]
    """Of the fragments [m^3], repeat by repeat."""
    floor: Distances
    """Mean over the pairs of repeats: the simulation-to-simulation variability."""
    answers: dict[str, SourceResult]
    """By the names of the sources."""

    @property
    def counts(self) -> tuple[int, ...]:
        """Fragments of each repeat."""
        return tuple(len(volumes) for volumes in self.volumes)


@dataclass(frozen=True, eq=False)
class Measurement:
    """A collision, and the partitions of the body by its repeats and by all draws, to compare it with others.

    Fragment 1..n of each voxel that the first of all patterns fills, shape (voxels,)."""

    collision: HeldOutCollision
    repeats: tuple[NDArray[np.uint16], ...]
    draws: dict[str, tuple[NDArray[np.uint16], ...]]


def measure(
    number: int,
    samples: Sequence[Sample],
    shape: Shape,
    sources: Mapping[str, PatternSource],
    *,
    inside: Ints,
    draws: int,
    seed: int,
) -> Measurement:
    """Let every source predict `draws` times how the shape breaks under the impact of `samples`.

    Args:
        number: Of the collision: with `seed` and the number of the draw it decides the generator that a source
            gets, so neither other sources nor the order of anything matters.
        samples: Repeats of this collision, two or more.
        inside: Voxels of the flattened `Descriptors.partition` that are kept.
    """
    impact = samples[0].impact
    repeats = [describe(sample.pattern, impact) for sample in samples]
    answers, divisions = {}, {}
    for name, source in sources.items():
        rngs = [np.random.default_rng([seed, number, draw]) for draw in range(draws)]
        predicted = [_predict(name, source, shape, impact, samples[0].pattern, rng) for rng in rngs]
        found = [describe(pattern, impact) for pattern, _, _ in predicted]
        answers[name] = SourceResult(
            _volumes(found),
            tuple(mean([distances(one, repeat) for repeat in repeats]) for one in found),
            mean([distances(a, b) for a, b in combinations(found, 2)]),
            tuple(seconds for _, seconds, _ in predicted),
            tuple(stages for _, _, stages in predicted),
        )
        divisions[name] = tuple(one.partition.ravel()[inside] for one in found)
    floor = mean([distances(a, b) for a, b in combinations(repeats, 2)])
    position, direction = (tuple(value[0].tolist()) for value in (impact.position, impact.direction))
    collision = HeldOutCollision(
        number, float(impact.magnitude[0]), position, direction, _volumes(repeats), floor, answers
    )  # fmt: skip
    return Measurement(collision, tuple(one.partition.ravel()[inside] for one in repeats), divisions)


def mean(rows: Sequence[Distances]) -> Distances:
    """Measure by measure; empty without rows."""
    return {name: float(np.mean([row[name] for row in rows])) for name in MEASURES} if rows else {}


def _volumes(traits: Sequence[Descriptors]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(one.volumes.tolist()) for one in traits)


def _predict(
    name: str, source: PatternSource, shape: Shape, impact: Impact, like: FracturePattern, rng: np.random.Generator
) -> tuple[FracturePattern, float, dict[str, float]]:
    """The pattern, the seconds that it took, and those of its stages."""
    with collect_stages() as collected:
        start = time.perf_counter()
        pattern = source(shape, impact, rng)
        seconds = time.perf_counter() - start
    stages: dict[str, float] = {}
    for step in collected:
        stages[step.stage] = stages.get(step.stage, 0.0) + step.seconds
    if pattern is None:  # it held: the body in one piece
        pattern = FracturePattern(like.grid, (like.labels > 0).astype(np.int32), like.distance)
    if pattern.grid != like.grid:
        raise BadInput(
            f"{name}: gives patterns at r = {pattern.grid.resolution}, the held-out ones are at r = "
            f"{like.grid.resolution}; use one resolution"
        )
    return pattern, seconds, stages
