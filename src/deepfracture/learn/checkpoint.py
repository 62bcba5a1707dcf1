"""Arrays and metadata in one safetensors file: reading it runs no code, and it is written completely or not at all."""

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
STEPS_PER_VOXEL = 256
"""Of the stored distance to the surface."""


def write(path: Path, kind: str, arrays: Mapping[str, NDArray], metadata: Mapping[str, Any]) -> None:
    """Write named arrays, and metadata that json can hold, as a file of `kind`."""
    from safetensors.numpy import save

    text = json.dumps({"kind": kind, **metadata})
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    with atomic_file(path) as temporary:
        temporary.write_bytes(save(contiguous, {KEY: text}))


def read(path: Path, kind: str) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """The arrays and metadata of a file of `kind`.

    Raises:
        BadInput: No such file, not safetensors (a pickle, say), damaged, or of another kind.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise BadInput(f"{path}: no such file; expected a {kind} written by deepfracture train")
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = json.loads((file.metadata() or {})[KEY])
            if metadata["kind"] != kind:
                raise BadInput(f"{path}: a {metadata['kind']}, not a {kind}")
            return {name: file.get_tensor(name) for name in file.keys()}, metadata  # noqa: SIM118 (no mapping)
    except (SafetensorError, ValueError, KeyError, TypeError, OSError, RecursionError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"{path}: not a {kind} of deepfracture, or damaged; train it again") from error


def check(path: Path, arrays: Mapping[str, NDArray], expected: Mapping[str, tuple[int, ...]]) -> None:
    """Check that every expected array is present, of its shape and finite.

    Raises:
        BadInput: Names the first that is not.
    """
    for name, shape in expected.items():
        array = arrays.get(name)
        if array is None or array.shape != shape:
            raise BadInput(f"{path}: {name} must have shape {shape}, got {None if array is None else array.shape}")
        if array.dtype not in (np.float16, np.float32) or not np.isfinite(array).all():
            raise BadInput(f"{path}: {name} must be finite float16 or float32, got {array.dtype}")


def pack_distance(distance: Floats32, grid: Grid) -> NDArray[np.uint8]:
    """A distance field [m], compressed, to 1/512 of a voxel."""
    steps = np.round(distance / grid.spacing * STEPS_PER_VOXEL).astype(np.int32)
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
    return (steps * (grid.spacing / STEPS_PER_VOXEL)).astype(np.float32)
