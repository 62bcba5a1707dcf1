"""The arrays of a data set: zarr version 3, written by zarr, read without trusting the stored headers.

`labels` and `distance` have shape (CAPACITY, r, r, r); every entry is one shard, an object of its own, divided into
chunks of at most 64^3 voxels compressed with zstd. Any zarr reader can `zarr.open(folder)["labels"][12]`. This program
ignores the headers in the folder: shape and type of the arrays follow from the manifest, so that neither a header nor
a chunk can make it allocate more memory than a pattern of that resolution needs.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from deepfracture.types import FracturePattern, Grid, Mesh

CAPACITY = 1_000_000
"""Entries that a data set can hold."""
PATTERN_ARRAYS = {"labels": np.dtype("<u2"), "distance": np.dtype("<f2")}
"""Arrays with one shard per entry, and their stored types."""
MESH_ARRAYS = {"vertices": np.dtype("<f8"), "faces": np.dtype("<i8")}
"""Arrays of the mesh, one chunk each."""
CHUNK = 64
"""Longest side of a chunk [voxels]."""
ZSTD_LEVEL = 7
"""Half the time of level 12, which saves 0.2 % more."""
EMPTY_CHUNK = 2**64 - 1
"""Offset and length in a shard's index for a chunk of zeros."""
OVERHEAD = 1 << 16
"""Bytes by which incompressible data may grow, index included."""


def group_headers() -> dict[str, bytes]:
    """The zarr headers of the groups, by key."""
    return {"zarr.json": _group_header(), "shape/zarr.json": _group_header()}


def array_header(name: str, resolution: int) -> tuple[str, bytes]:
    """Key and content of the zarr header of a pattern array."""
    return f"{name}/zarr.json", _empty_array(name, CAPACITY, resolution)["zarr.json"]


def shard_key(name: str, number: int) -> str:
    """Key of the shard of an entry."""
    return f"{name}/c/{number}/0/0/0"


def encode_pattern(pattern: FracturePattern) -> dict[str, bytes]:
    """The shards of a pattern by array name: the same bytes for the same pattern, empty for an array of zeros, for
    which zarr keeps no object.

    Raises:
        ValueError: It has more than 65,535 fragments, the largest label."""
    if pattern.labels.max() > np.iinfo(PATTERN_ARRAYS["labels"]).max:
        raise ValueError(f"{pattern.labels.max()} fragments; a data set stores up to 65535")
    return {name: _encode_shard(name, getattr(pattern, name).astype(kind)) for name, kind in PATTERN_ARRAYS.items()}


def decode_pattern(shards: dict[str, bytes], grid: Grid) -> FracturePattern:
    """The pattern in the shards of an entry.

    Raises:
        ValueError, RuntimeError: `encode_pattern` does not produce such shards."""
    return FracturePattern(
        grid, **{name: _decode_shard(shards[name], kind, grid) for name, kind in PATTERN_ARRAYS.items()}
    )


def max_shard_bytes(name: str, resolution: int) -> int:
    """Largest possible size of a shard [bytes]."""
    raw = PATTERN_ARRAYS[name].itemsize * resolution**3
    return raw + raw // 100 + OVERHEAD


def encode_mesh(mesh: Mesh) -> dict[str, bytes]:
    """The objects that hold a mesh, by key."""
    import zarr
    from zarr.storage import MemoryStore

    objects = {}
    for name, kind in MESH_ARRAYS.items():
        values = getattr(mesh, name).astype(kind)
        stored: dict[str, Any] = {}
        array = zarr.create_array(
            MemoryStore(stored), shape=values.shape, chunks=values.shape, dtype=kind, **_compression()
        )
        array[...] = values
        objects |= {f"shape/{name}/{key}": value.to_bytes() for key, value in stored.items()}
    return objects


def mesh_key(name: str) -> str:
    """Key of the chunk of `vertices` or `faces`."""
    return f"shape/{name}/c/0/0"


def decode_mesh_array(name: str, data: bytes, rows: int) -> NDArray:
    """`vertices` or `faces` from their chunk, shape (rows, 3).

    Raises:
        ValueError, RuntimeError: The chunk holds something else."""
    return _decompress(data, MESH_ARRAYS[name], (rows, 3))


def _decompress(data: bytes, kind: DTypeLike, shape: tuple[int, ...]) -> NDArray:
    """One zstd frame as an array of the given type and shape, whatever size the frame claims.

    Raises:
        ValueError, RuntimeError: It holds something else."""
    from numcodecs.zstd import Zstd

    values = np.zeros(shape, kind)
    # Into a buffer of the right size: zstd refuses a frame that does not fit before it allocates.
    Zstd().decode(data, values.reshape(-1).view(np.uint8))
    return values


def _decode_shard(shard: bytes, kind: np.dtype, grid: Grid) -> NDArray:
    """The array in a shard: chunks, then an index of their offsets and lengths (zarr codec sharding_indexed)."""
    values = np.zeros(grid.shape, kind)
    if not shard:
        return values
    side = min(CHUNK, grid.resolution)
    chunks = grid.resolution // side
    size = 16 * chunks**3
    # Four bytes of checksum follow; the record's SHA-256 covers the whole shard.
    index = np.frombuffer(shard[-size - 4 : -4], "<u8").reshape(chunks, chunks, chunks, 2)
    for i, j, k in np.ndindex(chunks, chunks, chunks):
        start, length = (int(value) for value in index[i, j, k])
        if start == length == EMPTY_CHUNK:
            continue
        x, y, z = (side * at for at in (i, j, k))
        block = _decompress(shard[start : start + length], kind, (side, side, side))
        values[x : x + side, y : y + side, z : z + side] = block
    return values


def _encode_shard(name: str, values: NDArray) -> bytes:
    import zarr
    from zarr.storage import MemoryStore

    stored = dict(_empty_array(name, 1, len(values), buffers=True))
    zarr.open_array(MemoryStore(stored), mode="r+")[0] = values
    return stored["c/0/0/0/0"].to_bytes() if "c/0/0/0/0" in stored else b""


@lru_cache(maxsize=16)
def _empty_array(name: str, entries: int, resolution: int, buffers: bool = False) -> dict[str, Any]:
    """The objects of an empty pattern array, by key."""
    import zarr
    from zarr.storage import MemoryStore

    side = min(CHUNK, resolution)
    stored: dict[str, Any] = {}
    zarr.create_array(
        MemoryStore(stored),
        shape=(entries, resolution, resolution, resolution),
        shards=(1, resolution, resolution, resolution),
        chunks=(1, side, side, side),
        dtype=PATTERN_ARRAYS[name],
        dimension_names=("entry", "x", "y", "z"),
        **_compression(),
    )
    return stored if buffers else {key: value.to_bytes() for key, value in stored.items()}


def _compression() -> dict[str, Any]:
    from zarr.codecs import BytesCodec, ZstdCodec

    return {"serializer": BytesCodec(endian="little"), "compressors": ZstdCodec(level=ZSTD_LEVEL), "fill_value": 0}


def _group_header() -> bytes:
    import zarr
    from zarr.storage import MemoryStore

    stored: dict[str, Any] = {}
    zarr.create_group(MemoryStore(stored))
    return stored["zarr.json"].to_bytes()
