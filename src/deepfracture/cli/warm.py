"""`warm`: run every kernel once, so that the compiled code is cached."""

from __future__ import annotations

import logging
import time

from deepfracture.breakers.options import BreakerOptions
from deepfracture.cli.options import ThrowOptions
from deepfracture.cli.shatter import shatter
from deepfracture.runtime.files import scratch_folder
from deepfracture.runtime.progress import log


def warm() -> None:
    """Compile and cache all kernels by breaking small things in a temporary folder; a second call is quick."""
    log.info("compiling the kernels, once per machine: two to five minutes ...")
    start, level = time.perf_counter(), log.level
    log.setLevel(logging.WARNING)
    try:
        for name, breaker in (("pot", "learned"), ("bar", "physical"), ("bar", "voronoi")):
            with scratch_folder() as folder:
                shatter(
                    name, breaker=breaker, out=folder, throw=ThrowOptions(speed=16.0, heading=0.0), seed=0,
                    options=BreakerOptions(resolution=32),
                )  # fmt: skip
    finally:
        log.setLevel(level)
    log.info("kernels ready, %.0f s", time.perf_counter() - start)
