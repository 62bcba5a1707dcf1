"""Feedback of long jobs: a logger, timed stages, and progress bars with the time left."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from threading import Lock, Timer
from typing import TYPE_CHECKING, TypeVar

from deepfracture.runtime.memory import peak_mb

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

log = logging.getLogger("deepfracture")
T = TypeVar("T")
SHOW_AFTER = 2.0
"""Run time after which a job is shown on a terminal [s]."""
LOG_EVERY = 20.0
"""Time between two progress lines in the log, where there is no terminal [s]."""


@dataclass(frozen=True)
class Stage:
    """One timed step of a job."""

    stage: str
    seconds: float
    peak_mb: float
    """Highest resident memory of the process so far [MB]."""


_stages: ContextVar[list[Stage] | None] = ContextVar("stages", default=None)


@contextmanager
def collect_stages() -> Iterator[list[Stage]]:
    """Collect the stages timed inside this block in the list, and in that of an enclosing block."""
    stages: list[Stage] = []
    outer = _stages.get()
    token = _stages.set(stages)
    try:
        yield stages
    finally:
        _stages.reset(token)
        if outer is not None:
            outer.extend(stages)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Time a named step; it is logged at INFO and collected by `collect_stages`."""
    start = time.perf_counter()
    with _display.running(name, None):
        yield
    record_stage(name, time.perf_counter() - start)


def record_stage(name: str, seconds: float) -> None:
    """Report a step that took `seconds` in total, as `stage` does."""
    done = Stage(name, seconds, peak_mb())
    log.info("%-24s %8.3f s %8.0f MB", done.stage, done.seconds, done.peak_mb)
    stages = _stages.get()
    if stages is not None:
        stages.append(done)


class StageTimer:
    """Accumulates the time of named steps that alternate many times."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def record(self) -> None:
        """Report the total of each step."""
        for name, seconds in self.seconds.items():
            record_stage(name, seconds)


@dataclass(eq=False)
class _Job:
    """A running job."""

    name: str
    total: int | None
    done: int = 0
    start: float = field(default_factory=time.perf_counter)

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.start

    @property
    def left(self) -> float | None:
        """Estimate of the remaining time at the average rate so far [s]."""
        return self.seconds / self.done * (self.total - self.done) if self.total and self.done else None


class _Display:
    """Jobs that have run for `SHOW_AFTER`, below the log on a terminal: each with a bar and the time left where they
    are known, until it is done.

    rich.progress has no delayed start, and importing rich takes 0.13 s: it is imported once a job has run that long."""

    def __init__(self) -> None:
        self.disabled = False
        self._jobs: list[_Job] = []
        self._lock = Lock()
        self._timer: Timer | None = None
        self._live: Live | None = None

    @contextmanager
    def running(self, name: str, total: int | None) -> Iterator[_Job]:
        job = _Job(name, total)
        if self.disabled or not sys.stderr.isatty():
            yield job
            return
        with self._lock:
            self._jobs.append(job)
            if self._timer is None:
                self._timer = Timer(SHOW_AFTER, self._show)
                self._timer.daemon = True
                self._timer.start()
        try:
            yield job
        finally:
            with self._lock:
                self._jobs.remove(job)
                if not self._jobs:
                    self._clear()

    def _show(self) -> None:
        from rich.console import Console
        from rich.live import Live

        with self._lock:
            if not self._jobs or self._live is not None:
                return
            self._live = Live(
                get_renderable=self._table, console=Console(stderr=True), refresh_per_second=5, transient=True
            )
            self._live.start()

    def _clear(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._live is not None:
            self._live.stop()
            self._live = None

    def _table(self) -> Table:
        from rich.progress_bar import ProgressBar
        from rich.table import Table

        table = Table.grid(padding=(0, 1))
        for job in list(self._jobs):
            if job.seconds < SHOW_AFTER:
                continue
            left = "" if job.left is None else f"{_clock(job.left)} left"
            count = f"{job.done} of {job.total}" if job.total else ""
            bar = ProgressBar(job.total, job.done, width=30) if job.total else ""
            table.add_row(job.name, bar, count, _clock(job.seconds), left)
        return table


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}" if minutes >= 60 else f"{minutes}:{rest:02d}"


_display = _Display()


def disable_progress(disabled: bool = True) -> None:
    """Show no progress at all; `disable_progress(False)` reverts it."""
    _display.disabled = disabled


def track(items: Iterable[T], *, name: str, total: int | None = None) -> Iterator[T]:
    """Iterate with a bar and the time left on a terminal, or a log line every `LOG_EVERY` elsewhere."""
    total = len(items) if total is None and hasattr(items, "__len__") else total  # type: ignore[arg-type]
    terminal, last = sys.stderr.isatty(), time.perf_counter()
    with _display.running(name, total) as job:
        for done, item in enumerate(items):
            job.done = done
            if not terminal and not _display.disabled and done and time.perf_counter() - last > LOG_EVERY:
                last = time.perf_counter()
                log.warning("%s: %d of %s, %.0f s left", name, done, total or "?", job.left or float("nan"))
            yield item
