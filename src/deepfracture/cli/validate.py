"""`validate`: the physics against closed forms, as a table."""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

from deepfracture.runtime.extras import require
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log

COLUMNS = f"{'case':<60} {'exact':>11} {'ours':>11} {'error':>9} {'limit':>9}  {'ok':<3} {'N':>5} {'seconds':>8}"


def validate(*, json_file: Path | None, plots: Path | None, quick: bool) -> bool:
    """Run every case, print the table, write `json_file` and pictures into `plots`; returns whether all pass."""
    from deepfracture.validation import draw, run_cases

    if plots:
        require("matplotlib", extra="plots", to="draw the plots of a validation")
    rows, level = [], log.level
    log.setLevel(logging.WARNING)  # the stages of each simulation would bury the table
    sys.stdout.write(f"{COLUMNS}\n")
    try:
        for outcome in run_cases(quick=quick):
            rows += outcome.rows
            for row in outcome.rows:
                sys.stdout.write(f"{_line(row)}\n")
            sys.stdout.flush()
            if plots:
                for plot in outcome.plots:
                    draw(plot, plots)
    finally:
        log.setLevel(level)
    if json_file:
        _write(json_file, rows)
    failed = [row for row in rows if not row["ok"]]
    sys.stdout.write(f"{len(rows) - len(failed)} of {len(rows)} within their limits\n")
    return not failed


def _line(row: dict) -> str:
    return (
        f"{row['case']:<60} {row['exact']:>11.5g} {row['ours']:>11.5g} {row['error']:>9.2g} {row['limit']:>9.2g}  "
        f"{'yes' if row['ok'] else 'NO':<3} {row['n']:>5} {row['seconds']:>8.1f}"
    )


def _write(path: Path, rows: list[dict]) -> None:
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
