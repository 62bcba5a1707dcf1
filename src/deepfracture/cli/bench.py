"""`bench`: time and memory of each stage on this machine."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from deepfracture.runtime.progress import log


def bench(
    room: str, *, shape: str, resolution: int, model: Path | None = None, json_file: Path | None,
    record: Path | None = None,
) -> None:  # fmt: skip
    """Measure `room` on `shape`, log the table, and write the rows to `json_file` if there is one; `record` keeps them
    in a folder with the machine and the date, and says how they compare with the last ones there."""
    from deepfracture.bench import bench as run
    from deepfracture.bench import comparison, keep, last, stamp, table
    from deepfracture.geometry import load_shape
    from deepfracture.runtime.files import atomic_file

    made = stamp()
    before = None if record is None else last(record, made)  # fails before the minutes that follow
    level = log.level
    log.setLevel("WARNING")  # the stages would bury the table
    try:
        rows = run(room, load_shape(shape), resolution, model)
    finally:
        log.setLevel(level)
    log.info("%s", table(rows))
    if json_file is not None:
        with atomic_file(json_file) as temporary:
            temporary.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    if record is not None:
        log.info("\n%s", comparison(rows, before) if before else "no earlier measurement on such a machine")
        log.info("%s: %s, %s cores, load %s", keep(rows, record, made), made["processor"], made["cores"], made["load"])
