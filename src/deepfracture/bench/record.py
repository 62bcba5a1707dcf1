"""Measurements that are kept, each with the machine and the moment, and how the last ones compare."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, fields
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from deepfracture._version import __version__
from deepfracture.bench.rows import Row
from deepfracture.types import BadInput

LIBRARIES = ("numpy", "scipy", "numba", "manifold3d", "rapier3d")
"""Whose versions may change how long something takes."""
SLOWER = 1.25
"""Ratio to the last measurement above which a stage is marked; below its inverse it is marked as quicker."""


def stamp() -> dict[str, Any]:
    """Where and when: processor, cores, versions, what else the machine does. No name of the machine or its user."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "deepfracture": __version__,
        "processor": processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "libraries": {name: known for name in LIBRARIES if (known := _version(name))},
        "load": load,
    }


def processor() -> str:
    """What the processor calls itself."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def keep(rows: Sequence[Row], folder: Path, made: dict[str, Any]) -> Path:
    """Write the rows with their stamp into a file of their own in `folder`; its path."""
    from deepfracture.runtime.files import atomic_file

    path = folder / f"bench-{made['date'].replace(':', '').replace('+0000', 'Z')}.json"
    with atomic_file(path) as temporary:
        temporary.write_text(
            json.dumps({"machine": made, "rows": [asdict(row) for row in rows]}, indent=1) + "\n", encoding="utf-8"
        )
    return path


def last(folder: Path, made: dict[str, Any]) -> tuple[dict[str, Any], list[Row]] | None:
    """Stamp and rows of the latest measurement in `folder` on a machine like that of `made`; None: there is none.

    Raises:
        BadInput: A file there is no measurement.
    """
    found = []
    for path in folder.glob("bench-*.json"):
        try:
            held = json.loads(path.read_text(encoding="utf-8"))
            rows = [Row(**{field.name: row[field.name] for field in fields(Row)}) for row in held["rows"]]
            machine = held["machine"]
            if all(machine[key] == made[key] for key in ("processor", "cores", "system")):
                found.append((machine["date"], machine, rows))
        except (OSError, ValueError, KeyError, TypeError) as problem:
            raise BadInput(f"{path}: not a measurement ({problem}); move it away") from problem
    if not found:
        return None
    _, machine, rows = max(found, key=lambda one: one[0])
    return machine, rows


def comparison(rows: Sequence[Row], before: tuple[dict[str, Any], list[Row]]) -> str:
    """Each stage that both know, as a ratio of now to then; `!` marks what takes over `SLOWER` times as long, `+`
    what takes less than its inverse."""
    machine, former = before
    then = {(row.stage, row.shape, row.resolution): row.seconds for row in former}
    lines = [f"against {machine['date']}, version {machine['deepfracture']}, load {machine['load']}"]
    lines.append(f"{'stage':<34} {'shape':<12} {'r':>4} {'then':>9} {'now':>9} {'ratio':>7}")
    for row in rows:
        had = then.get((row.stage, row.shape, row.resolution))
        if had:
            ratio = row.seconds / had
            mark = " !" if ratio > SLOWER else " +" if ratio < 1 / SLOWER else ""
            lines.append(
                f"{row.stage:<34} {row.shape:<12} {row.resolution:>4} {had:>9.4f} {row.seconds:>9.4f} "
                f"{ratio:>7.2f}{mark}"
            )
    return "\n".join(lines) if len(lines) > 2 else lines[0] + ": no stage in common"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
