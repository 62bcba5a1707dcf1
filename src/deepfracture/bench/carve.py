"""From a pattern to the field and back, and the cut of the original mesh."""

from __future__ import annotations

import numpy as np

from deepfracture.carve import cut, encode, segment
from deepfracture.geometry import signed_distance
from deepfracture.types import Grid, Shape

from .paper import paper_seconds
from .pieces import DENSITY, cells
from .rows import Row, measure


def bench_carve(shape: Shape, resolution: int) -> list[Row]:
    """Encode, segment and cut a pattern of `pieces.CELLS` Voronoi cells."""
    grid = Grid(resolution)
    surface = signed_distance(shape.mesh, grid)
    pattern = cells(surface, grid, np.random.default_rng(0))
    volume = encode(pattern, surface)
    jobs = {
        "encode": lambda: encode(pattern, surface),
        "segment": lambda: segment(volume),
        "cut": lambda: cut(shape, pattern, density=DENSITY),
    }
    return [
        measure(name, shape.name, resolution, job, paper_seconds(name, shape.name, resolution))
        for name, job in jobs.items()
    ]
