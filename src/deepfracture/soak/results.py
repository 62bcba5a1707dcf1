"""The file of a soak, a line of JSON a hit, and what it says."""

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
from deepfracture.soak.plan import SHARES, Case, Settings
from deepfracture.types import BadInput

Row = dict[str, Any]
FILE = "hits.jsonl"
WARM = 100
"""Hits, at least, before a process is warm: it must have met every shape with every breaker, and keeps those."""
GROWTH = 50.0
"""Memory that a process may take more at the end than when it was warm [MB]."""
SLOWEST = 5
"""Slowest hits that are named."""
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
    """Rows in memory and, where there is a folder, in a file that only grows: each line is on the disk, whole, before
    the next begins. What a kill cut short is dropped when it is opened again."""

    def __init__(self, settings: Settings, folder: Path | None) -> None:
        """BadInput if the folder holds a soak of other settings, or something else under that name."""
        self.rows: list[Row] = []
        self._file: int | None = None
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / FILE
        head = {"settings": json.loads(json.dumps(asdict(settings), default=str)), "version": __version__}
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
        """Numbers of the hits that are there."""
        return {row["number"] for row in self.rows}

    def add(self, row: Row) -> None:
        self.rows.append(row)
        if self._file is not None:
            self._write(row)

    def _write(self, row: Row) -> None:
        assert self._file is not None
        line = (json.dumps(row) + "\n").encode()
        if os.write(self._file, line) != len(line):
            raise OSError("the disk is full; run the same command again to go on")
        os.fsync(self._file)


def _whole_lines(path: Path) -> list[Row]:
    """What the file holds, cut off behind its last whole line."""
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
    for name in (field.name for field in fields(Settings)):
        if had.get(name) != have[name]:
            raise BadInput(f"{path}: made with {name} {had.get(name)}, not {have[name]}; give another folder")


def failed(rows: Iterable[Row]) -> list[Row]:
    """The hits with something wrong, in order."""
    return sorted((row for row in rows if row["failures"]), key=lambda row: row["number"])


def growth(rows: Sequence[Row]) -> float | None:
    """By how much the memory of a process grew from its warm start to its end [MB]: medians of the first and the
    last quarter of its hits after that. The most of all processes; None while none of them has done enough."""
    found = []
    for worker in dict.fromkeys(row.get("worker") for row in rows):
        own = [row for row in rows if row.get("worker") == worker and "resident_mb" in row]
        met = [(row["shape"], row["breaker"]) for row in own]
        warm = max([WARM, *(met.index(pair) + 1 for pair in set(met))])
        sizes = [row["resident_mb"] for row in own[warm:]]
        quarter = len(sizes) // 4
        if quarter >= WARM // 4:
            found.append(float(np.median(sizes[-quarter:]) - np.median(sizes[:quarter])))
    return max(found, default=None)


def sound(rows: Sequence[Row]) -> bool:
    """Whether nothing at all is wrong."""
    return not failed(rows) and (growth(rows) or 0.0) <= GROWTH


def summary(rows: Sequence[Row], settings: Settings) -> str:
    """The soak in Markdown: by breaker, by shape, the slowest hits, every failure with what repeats it."""
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
        _table(rows, "shape", settings.shapes),
        "Slowest:",
        "",
        *(_named(row, settings) for row in sorted(rows, key=lambda row: -row["seconds"])[:SLOWEST]),
        "",
        "Failed:" if failed(rows) else "No hit failed.",
        "",
        *(_named(row, settings) for row in failed(rows)),
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


def _named(row: Row, settings: Settings) -> str:
    one = Case(**{field.name: row[field.name] for field in fields(Case)})
    wrong = _counted(row["failures"])
    told = "; ".join(word for word in (wrong, row.get("detail", "")) if word)
    return f"- {row['seconds']:.1f} s" + (f", {told}" if told else "") + f": `{one.command(settings)}`"


def _counted(kinds: dict[str, int] | Counter[str]) -> str:
    return ", ".join(f"{kind} {count}" for kind, count in kinds.items())
