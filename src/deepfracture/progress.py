"""What a long job tells about itself: a logger, timed stages, and progress with the time left."""

from __future__ import annotations

import logging
import resource
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TypeVar

log = logging.getLogger("deepfracture")
T = TypeVar("T")


@dataclass(frozen=True)
class Stage:
    """One timed step of a job."""

    stage: str
    seconds: float
    peak_mb: float
    """Highest resident memory of the process so far [MB]."""


_stages: ContextVar[list[Stage] | None] = ContextVar("stages", default=None)


def peak_mb() -> float:
    """Highest resident memory of this process so far [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)


@contextmanager
def collect_stages() -> Iterator[list[Stage]]:
    """Everything that `stage` times inside this block ends up in the list."""
    stages: list[Stage] = []
    token = _stages.set(stages)
    try:
        yield stages
    finally:
        _stages.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Time a named step; logged at INFO and collected if someone asked."""
    start = time.perf_counter()
    yield
    record(name, time.perf_counter() - start)


def record(name: str, seconds: float) -> None:
    """Report a step that took `seconds` in all, as `stage` does."""
    done = Stage(name, seconds, peak_mb())
    log.info("%-24s %8.3f s %8.0f MB", done.stage, done.seconds, done.peak_mb)
    stages = _stages.get()
    if stages is not None:
        stages.append(done)


class Stopwatch:
    """Adds up the time of named steps that take turns many times."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def record(self) -> None:
        """Report each step once."""
        for name, seconds in self.seconds.items():
            record(name, seconds)


def track(items: Iterable[T], *, name: str, total: int | None = None) -> Iterator[T]:
    """Iterate with a bar and the time left on a terminal, and a log line now and then elsewhere."""
    total = len(items) if total is None and hasattr(items, "__len__") else total  # type: ignore[arg-type]
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import track as rich_track

        yield from rich_track(items, description=name, total=total, console=Console(stderr=True))
        return
    start = last = time.perf_counter()
    for done, item in enumerate(items):
        now = time.perf_counter()
        if done and now - last > 20:
            last = now
            left = (now - start) / done * (total - done) if total else float("nan")
            log.warning("%s: %d of %s, %.0f s left", name, done, total or "?", left)
        yield item
