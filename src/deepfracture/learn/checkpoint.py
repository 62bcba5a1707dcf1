"""Arrays and facts in one safetensors file: no code runs when it is read, and it is whole or not there."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepfracture.runtime.files import atomic_file
from deepfracture.types import BadInput, Floats32, Grid

KEY = "deepfracture"
STEPS = 256
"""Steps of the stored distance to the surface in a voxel."""


def write(path: Path, kind: str, arrays: Mapping[str, NDArray], facts: Mapping[str, Any]) -> None:
    """Store named arrays, and facts that json can hold, as a file of `kind`."""
    from safetensors.numpy import save

    text = json.dumps({"kind": kind, **facts})
    tidy = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    with atomic_file(path) as temporary:
        temporary.write_bytes(save(tidy, {KEY: text}))


def read(path: Path, kind: str) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """The arrays and facts of a file of `kind`.

    Raises:
        BadInput: No such file, not safetensors (a pickle, say), damaged, or of another kind.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise BadInput(f"{path}: no such file; expected a {kind} written by deepfracture train")
    try:
        with safe_open(path, framework="numpy") as file:
            facts = json.loads((file.metadata() or {})[KEY])
            if facts["kind"] != kind:
                raise BadInput(f"{path}: a {facts['kind']}, not a {kind}")
            return {name: file.get_tensor(name) for name in file.keys()}, facts  # noqa: SIM118 (no mapping)
    except (SafetensorError, ValueError, KeyError, TypeError, OSError, RecursionError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"{path}: not a {kind} of deepfracture, or damaged; train it again") from error


def check(path: Path, arrays: Mapping[str, NDArray], wanted: Mapping[str, tuple[int, ...]]) -> None:
    """Every wanted array is there, of its shape, a finite float.

    Raises:
        BadInput: Names the first that is not.
    """
    for name, shape in wanted.items():
        array = arrays.get(name)
        if array is None or array.shape != shape:
            raise BadInput(f"{path}: {name} must have shape {shape}, got {None if array is None else array.shape}")
        if array.dtype not in (np.float16, np.float32) or not np.isfinite(array).all():
            raise BadInput(f"{path}: {name} must be finite float16 or float32, got {array.dtype}")


def pack_distance(distance: Floats32, grid: Grid) -> NDArray[np.uint8]:
    """A distance field [m] to 1/512 of a voxel, small."""
    steps = np.round(distance / grid.spacing * STEPS).astype(np.int32)
    changes = np.diff(steps.ravel(), prepend=0).astype(np.int32)
    planes = np.ascontiguousarray(changes.view(np.uint8).reshape(-1, 4).T)  # high bytes compress to nothing
    return np.frombuffer(zlib.compress(planes.tobytes(), 9), np.uint8)


def unpack_distance(packed: NDArray[np.uint8], grid: Grid) -> Floats32:
    """The field that `pack_distance` stored. Raises `ValueError` on damage."""
    size = 4 * grid.resolution**3
    try:
        planes = zlib.decompressobj().decompress(packed.tobytes(), size)
    except zlib.error as error:
        raise ValueError(str(error)) from error
    changes = np.frombuffer(planes, np.uint8).reshape(4, -1).T.copy().view(np.int32)
    steps = np.cumsum(changes.ravel(), dtype=np.int64).reshape(grid.shape)
    return (steps * (grid.spacing / STEPS)).astype(np.float32)
