"""`bench`: what each stage costs on this machine."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

from deepfracture.progress import log


def bench(room: str, *, shape: str, resolution: int, model: Path | None = None, json_file: Path | None) -> None:
    """Measure `room` on `shape`, log the table, and write the rows to `json_file` if there is one."""
    from deepfracture.bench import bench as run
    from deepfracture.bench import table
    from deepfracture.geometry import load_shape

    level = log.level
    log.setLevel("WARNING")  # each stage would say how long it took
    try:
        rows = run(room, load_shape(shape), resolution, model)
    finally:
        log.setLevel(level)
    log.info("%s", table(rows))
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        temporary = json_file.with_name(f".{json_file.name}.{os.getpid()}.tmp")
        temporary.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
        os.replace(temporary, json_file)
