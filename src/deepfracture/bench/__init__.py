"""How long each stage takes on this machine, and what others have measured."""

from __future__ import annotations

from collections.abc import Callable

from deepfracture.types import BadInput, Shape

from .carve import bench_carve
from .fracture import bench_fracture
from .learn import bench_learn
from .rows import Row, table
from .world import bench_world

__all__ = ["BENCHES", "Row", "bench", "table"]

BENCHES: dict[str, Callable[[Shape, int], list[Row]]] = {
    "fracture": bench_fracture,
    "carve": bench_carve,
    "learn": bench_learn,
    "world": bench_world,
}


def bench(room: str, shape: Shape, resolution: int) -> list[Row]:
    """Measure one room of `BENCHES`, or `all` of them one after the other.

    Memory is that of the whole process so far: what counts is the first row that raises it."""
    if room == "all":
        return [row for each in BENCHES.values() for row in each(shape, resolution)]
    if room not in BENCHES:
        raise BadInput(f"bench {room!r}: unknown; choose one of {', '.join(BENCHES)} or all")
    return BENCHES[room](shape, resolution)
