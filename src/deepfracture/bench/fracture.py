"""The fracture simulator: a body's one-time set-up, and a hit with its stages."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from deepfracture.bench.hits import random_hits
from deepfracture.bench.rows import RUNS, WHOLE, Row, median_seconds, seconds, stage_totals
from deepfracture.fracture import FractureBody, material, prepare_body, simulate
from deepfracture.runtime.files import scratch_folder
from deepfracture.runtime.memory import peak_mb
from deepfracture.runtime.progress import collect_stages
from deepfracture.types import Grid, Impact, Shape

MATERIAL = "plaster"
HITS = 12
"""Random collisions whose median is the cost of a hit."""
# FractureRB (Hahn and Wojtan 2016, the simulator that the paper's data come from), built and run on two cores, at
# most 60 cracks: squirrel with 1500 boundary elements, 143 fragments, 1.5 GB; bar with 600, 63 fragments.
REFERENCE = "FractureRB on two cores"
REFERENCE_SECONDS = {"squirrel": 299.0, "bar": 35.0}


@dataclass(frozen=True)
class HitCost:
    """What one collision took."""

    impulse: float
    """The strongest [N s]."""
    seconds: float
    stages: Mapping[str, float]
    """Seconds of each stage of it, all calls together."""
    cracks: int
    fragments: int


def bench_fracture(shape: Shape, resolution: int) -> list[Row]:
    """Set-up without and with the cache, then the median of `HITS` random hits, stage by stage."""
    rows, body = _set_up(shape, resolution)
    impacts = random_hits(shape, body.material, HITS)
    simulate(body, impacts[0], np.random.default_rng(0))
    costs = [hit_cost(body, impact, seed) for seed, impact in enumerate(impacts)]
    return rows + _hits(shape.name, resolution, costs)


def hit_cost(body: FractureBody, impact: Impact, seed: int) -> HitCost:
    """Simulate one collision and say what it took."""
    found = []
    with collect_stages() as stages:
        spent = seconds(lambda: found.append(simulate(body, impact, np.random.default_rng(seed))))
    cracking = found[0]
    cracks, fragments = (cracking.cracks, cracking.pattern.count) if cracking else (0, 1)
    return HitCost(float(impact.magnitude[0]), spent, stage_totals(stages), cracks, fragments)


def _set_up(shape: Shape, resolution: int) -> tuple[list[Row], FractureBody]:
    grid, made_of = Grid(resolution), material(MATERIAL)
    runs = []
    for _ in range(RUNS + 1):
        with empty_cache(), collect_stages() as stages:
            runs.append((seconds(lambda: prepare_body(shape, made_of, grid)), stage_totals(stages)))
    rows = [Row("set-up, nothing cached", shape.name, resolution, _median(spent for spent, _ in runs[1:]), peak_mb())]
    for name in runs[-1][1]:
        part = _median(parts[name] for _, parts in runs[1:])
        rows.append(Row(f"set-up / {name}", shape.name, resolution, part, peak_mb()))
    body = prepare_body(shape, made_of, grid)
    cached = median_seconds(lambda: prepare_body(shape, made_of, grid))
    return [*rows, Row("set-up, cached", shape.name, resolution, cached, peak_mb())], body


def _hits(name: str, resolution: int, costs: Sequence[HitCost]) -> list[Row]:
    theirs = REFERENCE_SECONDS.get(name)
    reference = (REFERENCE if theirs else "", theirs)

    def row(stage: str, spent: float, reference: tuple[str, float | None] = ("", None)) -> Row:
        return Row(stage, name, resolution, spent, peak_mb(), *reference)

    stages = dict.fromkeys(stage for cost in costs for stage in cost.stages)
    return [
        row(WHOLE, _median(cost.seconds for cost in costs), reference),
        *(row(f"{WHOLE} / {s}", _median(cost.stages.get(s, 0.0) for cost in costs)) for s in stages),
        row(f"{WHOLE}, strongest", max(costs, key=lambda cost: cost.impulse).seconds, reference),
        row(f"{WHOLE}, slowest", max(cost.seconds for cost in costs), reference),
    ]


def _median(values: Iterator[float]) -> float:
    return float(np.median(list(values)))


@contextmanager
def empty_cache() -> Iterator[None]:
    """A folder of its own for what is kept between runs, so that nothing is found there."""
    before = os.environ.get("XDG_CACHE_HOME")
    with scratch_folder() as folder:
        os.environ["XDG_CACHE_HOME"] = str(folder)
        try:
            yield
        finally:
            if before is None:
                del os.environ["XDG_CACHE_HOME"]
            else:
                os.environ["XDG_CACHE_HOME"] = before
