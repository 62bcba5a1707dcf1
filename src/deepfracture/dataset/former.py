"""Data sets of formats 1 and 2, a zarr group for every sample: read to be converted, and nowhere else."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

import numpy as np

from deepfracture.dataset.arrays import ARRAYS, SHAPE, SLACK, unpack
from deepfracture.dataset.record import IMPACT_FIELDS, LARGEST, Record, parse
from deepfracture.dataset.storage import Storage
from deepfracture.dataset.store import LARGEST_MESH, Settings, digest
from deepfracture.types import FracturePattern, Grid, Impact, Mesh

FOLDERS = {"samples": "broken", "unbroken": "unbroken", "failed": "failed"}
UNSAID = {"scene": "single", "refracture": 0, "frames": 0, "repeats": 1}
"""What older manifests do not say, and what their data sets are."""
LABELS = ("uint8", "uint16")


def former_settings(storage: Storage, manifest: dict[str, Any]) -> Settings:
    """What was simulated.

    Raises:
        ValueError, KeyError, TypeError, RuntimeError: It cannot be read."""
    parts = []
    for name, kind in SHAPE.items():
        rows, columns = _header(storage, f"shape/{name}")["shape"]
        if columns != 3 or not 0 < rows <= LARGEST_MESH:
            raise ValueError(f"shape/{name} of shape ({rows}, {columns})")
        parts.append(unpack(_read(storage, f"shape/{name}/c/0/0", 24 * rows + SLACK), kind, (rows, 3)))
    mesh = Mesh(*parts)
    if digest(mesh)[:16] != manifest["shape"]["mesh"]:
        raise ValueError("the mesh beside it is another one")
    return Settings.of(UNSAID | manifest, mesh)


def former_entries(storage: Storage) -> dict[int, str]:
    """What has been tried: numbers, and where it lies."""
    found = {}
    for folder in FOLDERS:
        for name in storage.names(folder):
            number = name.removesuffix(".json")
            if len(number) == 6 and number.isdigit():
                found[int(number)] = f"{folder}/{name}"
    return found


def former_entry(storage: Storage, number: int, place: str, grid: Grid) -> tuple[Record, FracturePattern | None]:
    """What became of one collision.

    Raises:
        ValueError, KeyError, TypeError, RuntimeError: It cannot be read."""
    kind = FOLDERS[PurePosixPath(place).parts[0]]
    if kind == "broken":
        about = parse(_read(storage, f"{place}/zarr.json", LARGEST))["attributes"]
        arrays = {name: about[name] for name in IMPACT_FIELDS}
        impact = Impact(**arrays, speed=float(about["speed"]), radius=float(about["radius"]))
        labels = _header(storage, f"{place}/labels")["data_type"]
        if labels not in LABELS:
            raise ValueError(f"labels of type {str(labels)[:40]}")
        kinds = {"labels": np.dtype(labels).newbyteorder("<"), "distance": ARRAYS["distance"]}
        largest = 2 * grid.resolution**3 + SLACK
        values = {
            name: unpack(_read(storage, f"{place}/{name}/c/0/0/0", largest), dtype, grid.shape)
            for name, dtype in kinds.items()
        }
        pattern = FracturePattern(grid, **values)
        return Record(number, kind, int(about["seed"]), impact, pattern.count), pattern
    about = parse(_read(storage, place, LARGEST))
    if kind == "failed":
        return Record(number, kind, int(about["seed"]), reason=str(about["reason"])), None
    hit = about["impact"] or {}
    impulse, speed = (None if name not in hit else float(hit[name]) for name in ("impulse", "speed"))
    return Record(number, kind, int(about["seed"]), impulse=impulse, speed=speed), None


def _header(storage: Storage, array: str) -> dict[str, Any]:
    return parse(_read(storage, f"{array}/zarr.json", LARGEST))


def _read(storage: Storage, key: str, limit: int) -> bytes:
    data = storage.read(key, limit)
    if data is None:
        raise ValueError(f"no {key}")
    return data
