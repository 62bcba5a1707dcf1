"""How long each stage takes on this machine, and what others have measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from deepfracture.bench.carve import bench_carve
from deepfracture.bench.fracture import bench_fracture
from deepfracture.bench.learn import bench_learn
from deepfracture.bench.record import comparison, keep, last, stamp
from deepfracture.bench.rows import Row, table
from deepfracture.bench.world import bench_world
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Shape

__all__ = ["BENCHES", "Row", "bench", "comparison", "keep", "last", "stamp", "table"]

BENCHES: dict[str, Callable[[Shape, int, Path | None], list[Row]]] = {
    "fracture": lambda shape, resolution, _: bench_fracture(shape, resolution),
    "carve": bench_carve,
    "learn": bench_learn,
    "world": lambda shape, resolution, _: bench_world(shape, resolution),
}


def bench(room: str, shape: Shape, resolution: int, model: Path | None = None) -> list[Row]:
    """Measure one room of `BENCHES`, or `all` of them one after the other; `model` is what predicts, where that
    is part of it, in place of the shipped one.

    Memory is that of the whole process so far: what counts is the first row that raises it."""
    if room == "all":
        return [row for each in BENCHES.values() for row in each(shape, resolution, model)]
    if room not in BENCHES:
        raise BadInput(
            f"bench {room!r}: unknown; choose one of {', '.join(BENCHES)} or all{did_you_mean(room, (*BENCHES, 'all'))}"
        )
    return BENCHES[room](shape, resolution, model)
