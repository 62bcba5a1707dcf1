"""One measured stage, how it is measured, and the table that is printed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deepfracture.runtime.memory import peak_mb
from deepfracture.runtime.progress import Stage

RUNS = 5
"""Warm runs whose median counts."""
WHOLE = "hit"
"""The stages `WHOLE / name` are parts of this one."""


@dataclass(frozen=True)
class Row:
    """One stage: what it costs here, and what it cost others."""

    stage: str
    shape: str
    resolution: int
    """Voxels along an axis."""
    seconds: float
    """Median of warm runs."""
    peak_mb: float
    """Highest resident memory of the process by the end of the stage [MB]."""
    reference: str = ""
    """Who measured `reference_seconds`, empty if nobody did."""
    reference_seconds: float | None = None


def median_seconds(job: Callable[[], object], *, runs: int = RUNS) -> float:
    """Median wall time of `runs` calls after one that does not count [s]."""
    job()
    return float(np.median([seconds(job) for _ in range(runs)]))


def seconds(job: Callable[[], object]) -> float:
    """Wall time of one call [s]."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def stage_totals(stages: Sequence[Stage]) -> dict[str, float]:
    """Seconds of each stage, all its calls together."""
    totals: dict[str, float] = {}
    for done in stages:
        totals[done.stage] = totals.get(done.stage, 0.0) + done.seconds
    return totals


def measure(
    stage: str, shape: str, resolution: int, job: Callable[[], object], reference: tuple[str, float | None] = ("", None)
) -> Row:
    """The row of a job, warmed up by one call that does not count."""
    return Row(stage, shape, resolution, median_seconds(job), peak_mb(), *reference)


def share(row: Row, rows: Sequence[Row]) -> float | None:
    """The part of the stage `a` that its part `a / b` takes; None for anything else."""
    whole, _, part = row.stage.rpartition(" / ")
    among = [r.seconds for r in rows if (r.stage, r.shape, r.resolution) == (whole, row.shape, row.resolution)]
    return row.seconds / among[0] if part and among else None


def table(rows: Sequence[Row]) -> str:
    """The rows as text, one a line below a heading."""
    lines = [f"{'stage':<34} {'shape':<12} {'r':>4} {'seconds':>9} {'share':>6} {'peak MB':>8}   reference"]
    for row in rows:
        part = share(row, rows)
        percent = "" if part is None else f"{part:.0%}"
        other = "" if row.reference_seconds is None else f"{row.reference_seconds:g} s, {row.reference}"
        lines.append(
            f"{row.stage:<34} {row.shape:<12} {row.resolution:>4} {row.seconds:>9.4f} {percent:>6} "
            f"{row.peak_mb:>8.0f}   {other}".rstrip()
        )
    return "\n".join(lines)
