"""`warm`: run every kernel once on a small case, so that the compiled code is in the cache."""

from __future__ import annotations

import time

import numpy as np

from deepfracture.progress import log


def warm() -> None:
    """Compile and cache all kernels; a second call is quick."""
    from deepfracture.breakers import make_breaker
    from deepfracture.carve import encode, segment
    from deepfracture.fracture import material
    from deepfracture.geometry import builtin, signed_distance
    from deepfracture.types import Grid, Impact

    log.info("compiling the kernels (once a machine, about a minute) ...")
    start = time.perf_counter()
    shape, clay, grid = builtin("bar"), material("plaster"), Grid(32)
    hit = Impact(
        position=np.array([[0.0, 0.0, 0.2]]), direction=np.array([[0.0, 0.0, -1.0]]), magnitude=np.array([3000.0]),
        normal=np.array([[0.0, 0.0, 1.0]]), speed=15.0, radius=0.2,
    )  # fmt: skip
    for name in ("physical", "voronoi"):
        make_breaker(name, shape, clay, grid)(shape, hit, np.random.default_rng(0))
    from deepfracture.carve import voronoi_pattern

    surface = signed_distance(shape.mesh, grid)
    segment(encode(voronoi_pattern(np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]), surface, grid), surface))
    log.info("kernels ready, %.0f s", time.perf_counter() - start)
