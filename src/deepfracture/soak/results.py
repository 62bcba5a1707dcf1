"""Results of a soak: a file with a line of JSON per hit, and their summary."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from deepfracture._version import __version__
from deepfracture.soak.plan import SHARES, Case, SoakOptions
from deepfracture.types import BadInput

Row = dict[str, Any]
FILE = "hits.jsonl"
WARM_UP = 100
"""Least number of hits before a process is warm; it must also have cached every shape with every breaker."""
MEMORY_GROWTH = 50.0
"""Largest growth of a process's memory after its warm-up [MB]."""
SLOWEST = 5
"""Number of slowest hits in the summary."""
HEAD = (
    "",
    "hits",
    "broke",
    "fragments",
    "failed",
    "seconds 50 %",
    "99 %",
    "slowest",
    "of which breaking 50 %",
    "of a processor 50 %",
    "slowest",
)


class Results:
    """Rows in memory and, given a folder, in an append-only file: each line is on the disk before the next is written.
    A line cut short by a kill is dropped when the file is reopened."""

    def __init__(self, options: SoakOptions, folder: Path | None) -> None:
        """BadInput if the folder holds a soak of other options, or another file of that name."""
        self.rows: list[Row] = []
        self._file: int | None = None
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / FILE
        head = {"settings": json.loads(json.dumps(asdict(options), default=str)), "version": __version__}
        lines = _whole_lines(path)
        if lines:
            _same(path, lines[0].get("settings"), head["settings"])
            self.rows = lines[1:]
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        if not lines:
            self._write(head)

    def __enter__(self) -> Results:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            os.close(self._file)

    @property
    def done(self) -> set[int]:
        """Numbers of the finished hits."""
        return {row["number"] for row in self.rows}

    def add(self, row: Row) -> None:
        self.rows.append(row)
        if self._file is not None:
            self._write(row)

    def _write(self, row: Row) -> None:
        assert self._file is not None
        line = (json.dumps(row) + "\n").encode()
        if os.write(self._file, line) != len(line):
            raise OSError("the disk is full; rerun the same command to resume")
        os.fsync(self._file)


def _whole_lines(path: Path) -> list[Row]:
    """The lines of the file, which is truncated after its last complete one."""
    if not path.exists():
        return []
    content = path.read_bytes()
    end = content.rfind(b"\n") + 1
    if end < len(content):
        os.truncate(path, end)
    try:
        return [json.loads(line) for line in content[:end].splitlines()]
    except json.JSONDecodeError as problem:
        raise BadInput(f"{path}: not the results of a soak ({problem}); give another folder") from problem


def _same(path: Path, had: Any, have: Row) -> None:
    if not isinstance(had, dict):
        raise BadInput(f"{path}: not the results of a soak; give another folder")
    for name in (field.name for field in fields(SoakOptions)):
        if had.get(name) != have[name]:
            raise BadInput(f"{path}: made with {name} {had.get(name)}, not {have[name]}; give another folder")


def failed(rows: Iterable[Row]) -> list[Row]:
    """The failed hits, in order."""
    return sorted((row for row in rows if row["failures"]), key=lambda row: row["number"])


def growth(rows: Sequence[Row]) -> float | None:
    """Growth of memory after the warm-up [MB]: median of the last quarter of a process's hits less that of the first
    quarter. The largest of all processes; None if none has enough hits."""
    found = []
    for worker in dict.fromkeys(row.get("worker") for row in rows):
        own = [row for row in rows if row.get("worker") == worker and "resident_mb" in row]
        met = [(row["shape"], row["breaker"]) for row in own]
        warm = max([WARM_UP, *(met.index(pair) + 1 for pair in set(met))])
        sizes = [row["resident_mb"] for row in own[warm:]]
        quarter = len(sizes) // 4
        if quarter >= WARM_UP // 4:
            found.append(float(np.median(sizes[-quarter:]) - np.median(sizes[:quarter])))
    return max(found, default=None)


def sound(rows: Sequence[Row]) -> bool:
    """Whether no hit failed and memory does not grow."""
    return not failed(rows) and (growth(rows) or 0.0) <= MEMORY_GROWTH


def summary(rows: Sequence[Row], options: SoakOptions) -> str:
    """The soak in Markdown: by breaker, by shape, the slowest hits, and each failure with the command to repeat it."""
    if not rows:
        return "No hit yet.\n"
    kinds = Counter(kind for row in rows for kind in row["failures"])
    grown = growth(rows)
    lows, flung = (max((row.get(key, 0.0) for row in rows), default=0.0) for key in ("deepest", "volume_error"))
    lines = [
        f"{len(rows)} hits, {sum(row.get('breaks', 0) > 0 for row in rows)} broke something, "
        f"{sum(row.get('fragments', 0) for row in rows)} fragments, {sum(row.get('again', 0) for row in rows)} pieces "
        f"broken again; {len(failed(rows))} hits failed" + (f" ({_counted(kinds)})." if kinds else "."),
        f"Volumes add up to {100 * flung:.1e} % at worst; the deepest that a corner got below the floor: {lows:.3f} m.",
        "Memory: " + ("too few hits to tell." if grown is None else f"{grown:+.0f} MB from the warm start to the end."),
        "",
        _table(rows, "breaker", tuple(SHARES)),
        _table(rows, "shape", options.shapes),
        "Slowest:",
        "",
        *(_named(row, options) for row in sorted(rows, key=lambda row: -row["seconds"])[:SLOWEST]),
        "",
        "Failed:" if failed(rows) else "No hit failed.",
        "",
        *(_named(row, options) for row in failed(rows)),
    ]
    return "\n".join(lines).rstrip() + "\n"


def _table(rows: Sequence[Row], key: str, order: Sequence[str]) -> str:
    cells = [[key, *HEAD[1:]], ["---"] * len(HEAD)]
    for name in order:
        own = [row for row in rows if row[key] == name]
        if own:
            cells.append([name, *_line(own)])
    cells.append(["all", *_line(rows)])
    return "\n".join("| " + " | ".join(line) + " |" for line in cells) + "\n"


def _line(rows: Sequence[Row]) -> list[str]:
    def at(key: str, share: float, keep: Callable[[Row], bool] = lambda row: True) -> str:
        values = [row[key] for row in rows if key in row and keep(row)]
        return f"{np.quantile(values, share):.2f}" if values else ""

    broke = [row for row in rows if row.get("breaks", 0) > 0]
    counts = [
        str(len(rows)),
        str(len(broke)),
        str(sum(row.get("fragments", 0) for row in rows)),
        str(len(failed(rows))),
    ]
    times = [at("seconds", share) for share in (0.5, 0.99, 1.0)]
    breaking = at("break_seconds", 0.5, lambda row: row.get("breaks", 0) > 0)
    return [*counts, *times, breaking, at("processor_seconds", 0.5), at("processor_seconds", 1.0)]


def _named(row: Row, options: SoakOptions) -> str:
    one = Case(**{field.name: row[field.name] for field in fields(Case)})
    wrong = _counted(row["failures"])
    told = "; ".join(word for word in (wrong, row.get("detail", "")) if word)
    return f"- {row['seconds']:.1f} s" + (f", {told}" if told else "") + f": `{one.command(options)}`"


def _counted(kinds: dict[str, int] | Counter[str]) -> str:
    return ", ".join(f"{kind} {count}" for kind, count in kinds.items())
