"""The arrays of a data set: zarr version 3, written by zarr, read with nothing taken on trust.

`labels` and `distance` have shape (CAPACITY, r, r, r); every entry is one shard, an object of its own, divided into
chunks of at most 64^3 voxels that zstd compresses. Anybody can `zarr.open(folder)["labels"][12]`. This program does
not obey the headers that lie in the folder: what the arrays are follows from the manifest, so that neither a header nor
a chunk can make it take more memory than a pattern of that resolution needs.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from deepfracture.types import FracturePattern, Grid, Mesh

CAPACITY = 1_000_000
"""Entries that a data set can hold."""
ARRAYS = {"labels": np.dtype("<u2"), "distance": np.dtype("<f2")}
"""Those that every entry has, and how they are stored."""
SHAPE = {"vertices": np.dtype("<f8"), "faces": np.dtype("<i8")}
"""Those of the mesh, one chunk each."""
CHUNK = 64
"""Longest side of a chunk."""
LEVEL = 7
"""Of zstd: half the time of level 12, which saves 0.2 % more."""
EMPTY = 2**64 - 1
"""What the index says of a chunk in which all is zero."""
SLACK = 1 << 16
"""Bytes by which what cannot be compressed may grow, index included."""


def headers() -> dict[str, bytes]:
    """The objects that say to zarr what lies in the folder, apart from those of the arrays."""
    return {"zarr.json": _group(), "shape/zarr.json": _group()}


def array_header(name: str, resolution: int) -> tuple[str, bytes]:
    """The header of an array of the entries: its key, and what it says."""
    return f"{name}/zarr.json", _made(name, CAPACITY, resolution)["zarr.json"]


def entry_key(name: str, number: int) -> str:
    """Where the shard of an entry lies."""
    return f"{name}/c/{number}/0/0/0"


def shards(pattern: FracturePattern) -> dict[str, bytes]:
    """A pattern as the shards of its arrays, the same bytes for the same pattern; empty where all is zero: zarr keeps
    no object for that.

    Raises:
        ValueError: It has more fragments than labels have values, 65,535."""
    if pattern.labels.max() > np.iinfo(ARRAYS["labels"]).max:
        raise ValueError(f"{pattern.labels.max()} fragments, a data set tells 65535 apart")
    return {name: _packed(name, getattr(pattern, name).astype(kind)) for name, kind in ARRAYS.items()}


def pattern_of(found: dict[str, bytes], grid: Grid) -> FracturePattern:
    """The pattern of an entry's shards.

    Raises:
        ValueError, RuntimeError: They are not what `shards` makes."""
    return FracturePattern(grid, **{name: _unpacked(found[name], kind, grid) for name, kind in ARRAYS.items()})


def largest_shard(name: str, resolution: int) -> int:
    """Bytes that the shard of an entry can have at most."""
    raw = ARRAYS[name].itemsize * resolution**3
    return raw + raw // 100 + SLACK


def mesh_objects(mesh: Mesh) -> dict[str, bytes]:
    """Keys and bytes of the arrays that hold a mesh."""
    import zarr
    from zarr.storage import MemoryStore

    objects = {}
    for name, kind in SHAPE.items():
        values = getattr(mesh, name).astype(kind)
        found: dict[str, Any] = {}
        store = MemoryStore(found)
        array = zarr.create_array(store, shape=values.shape, chunks=values.shape, dtype=kind, **_compressed())
        array[...] = values
        objects |= {f"shape/{name}/{key}": value.to_bytes() for key, value in found.items()}
    return objects


def mesh_key(name: str) -> str:
    """Where the chunk of `vertices` or `faces` lies."""
    return f"shape/{name}/c/0/0"


def mesh_values(name: str, data: bytes, rows: int) -> NDArray:
    """`vertices` or `faces` from their chunk, shape (rows, 3).

    Raises:
        ValueError, RuntimeError: The chunk holds something else."""
    return unpack(data, SHAPE[name], (rows, 3))


def unpack(data: bytes, kind: DTypeLike, shape: tuple[int, ...]) -> NDArray:
    """One zstd frame as the array that it must be; the frame's own claims decide nothing.

    Raises:
        ValueError, RuntimeError: It is another one."""
    from numcodecs.zstd import Zstd

    values = np.zeros(shape, kind)
    # Into a buffer of the right size: zstd refuses what would not fit, before it takes memory.
    Zstd().decode(data, values.reshape(-1).view(np.uint8))
    return values


def _unpacked(shard: bytes, kind: np.dtype, grid: Grid) -> NDArray:
    """The array in a shard: chunk after chunk, their places in an index at the end (zarr, sharding_indexed)."""
    values = np.zeros(grid.shape, kind)
    if not shard:
        return values
    side = min(CHUNK, grid.resolution)
    many = grid.resolution // side
    size = 16 * many**3
    # Four bytes of checksum follow; the record's SHA-256 covers the whole shard.
    index = np.frombuffer(shard[-size - 4 : -4], "<u8").reshape(many, many, many, 2)
    for i, j, k in np.ndindex(many, many, many):
        start, length = (int(value) for value in index[i, j, k])
        if start == length == EMPTY:
            continue
        block = unpack(shard[start : start + length], kind, (side, side, side))
        x, y, z = (side * at for at in (i, j, k))
        values[x : x + side, y : y + side, z : z + side] = block
    return values


def _packed(name: str, values: NDArray) -> bytes:
    import zarr
    from zarr.storage import MemoryStore

    found = dict(_made(name, 1, len(values), buffers=True))
    zarr.open_array(MemoryStore(found), mode="r+")[0] = values
    return found["c/0/0/0/0"].to_bytes() if "c/0/0/0/0" in found else b""


@lru_cache(maxsize=16)
def _made(name: str, entries: int, resolution: int, buffers: bool = False) -> dict[str, Any]:
    """An empty array of the entries, in memory."""
    import zarr
    from zarr.storage import MemoryStore

    side = min(CHUNK, resolution)
    found: dict[str, Any] = {}
    zarr.create_array(
        MemoryStore(found),
        shape=(entries, resolution, resolution, resolution),
        shards=(1, resolution, resolution, resolution),
        chunks=(1, side, side, side),
        dtype=ARRAYS[name],
        dimension_names=("entry", "x", "y", "z"),
        **_compressed(),
    )
    return found if buffers else {key: value.to_bytes() for key, value in found.items()}


def _compressed() -> dict[str, Any]:
    from zarr.codecs import BytesCodec, ZstdCodec

    return {"serializer": BytesCodec(endian="little"), "compressors": ZstdCodec(level=LEVEL), "fill_value": 0}


def _group() -> bytes:
    import zarr
    from zarr.storage import MemoryStore

    found: dict[str, Any] = {}
    zarr.create_group(MemoryStore(found))
    return found["zarr.json"].to_bytes()
