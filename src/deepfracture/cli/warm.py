"""`warm`: run every kernel once, so that the compiled code is in the cache."""

from __future__ import annotations

import logging
import time

from deepfracture.runtime.files import scratch_folder
from deepfracture.runtime.progress import log


def warm() -> None:
    """Compile and cache all kernels by breaking small things in a temporary folder; a second call is quick."""
    from deepfracture.cli.main import Throw
    from deepfracture.cli.shatter import shatter

    log.info("compiling the kernels, once a machine, two to five minutes ...")
    start, level = time.perf_counter(), log.level
    log.setLevel(logging.WARNING)
    try:
        for name, breaker in (("pot", "learned"), ("bar", "physical"), ("bar", "voronoi")):
            with scratch_folder() as folder:
                shatter(
                    name, breaker=breaker, out=folder, material="plaster", throw=Throw(speed=16.0, heading=0.0),
                    scene=None, model=None, dataset=None, resolution=32, roughness=0.0, engine="rapier", seed=0,
                    repair=False, film=True,
                )  # fmt: skip
    finally:
        log.setLevel(level)
    log.info("kernels ready, %.0f s", time.perf_counter() - start)
