"""A data set from a stranger can neither take unbounded memory nor reach outside its folder."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture.dataset import DatasetSettings, create_dataset, open_dataset, verify_dataset, write_sample
from deepfracture.dataset.arrays import mesh_key, shard_key
from deepfracture.dataset.record import ObjectInfo, read_record
from deepfracture.types import BadInput
from tests.tools.synthetic import CLAY, TETRAHEDRON, random_sample

ENOUGH = 20e6
"""Bytes with which anything below can be found out."""
SETTINGS = DatasetSettings(TETRAHEDRON, CLAY, 32, 0, (1.0, 9.0))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set of two samples."""
    rng = np.random.default_rng(0)
    storage = create_dataset(tmp_path / "set", SETTINGS)
    for k in range(2):
        write_sample(storage, k, random_sample(rng))
    return tmp_path / "set"


@contextmanager
def little_memory() -> Iterator[None]:
    tracemalloc.start()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < ENOUGH


def claiming(size: int) -> bytes:
    """A zstd frame that says that it holds `size` bytes."""
    return bytes.fromhex("28b52ffde0") + struct.pack("<Q", size) + b"\x01\x00\x00"


def forged(folder: Path, shard: bytes, **changes: object) -> None:
    """Put `shard` in the place of entry 0's labels, with a record that agrees with it."""
    record = read_record(0, (folder / "entries/000000.json").read_bytes())
    objects = {**record.objects, "labels": ObjectInfo.of(shard)}
    (folder / shard_key("labels", 0)).write_bytes(shard)
    (folder / "entries/000000.json").write_bytes(replace(record, objects=objects, **changes).to_bytes())


SHARDS: dict[str, Callable[[], bytes]] = {
    "a frame of 32 terabytes": lambda: claiming(1 << 45) + struct.pack("<QQI", 0, 16, 0),
    "a frame of another size": lambda: claiming(32**3 * 2 - 1) + struct.pack("<QQI", 0, 16, 0),
    "an index that points outside": lambda: b"\0" * 10 + struct.pack("<QQI", 1 << 62, 1 << 62, 0),
    "nothing but an index": lambda: struct.pack("<QQI", 0, 0, 0),
    "a few bytes": lambda: b"abc",
    "more than any pattern needs": lambda: os.urandom(1 << 20),
}


@pytest.mark.parametrize("name", SHARDS)
def test_shards_that_lie(folder: Path, name: str) -> None:
    forged(folder, SHARDS[name]())
    data = open_dataset(folder)
    with little_memory(), pytest.raises(BadInput, match="entry 000000: damaged sample") as caught:
        data[0]
    assert "\n" not in str(caught.value)
    assert set(verify_dataset(folder)[1]) == {0}
    assert data[1].pattern.count == 4


def test_headers_are_not_obeyed(folder: Path) -> None:
    """zarr itself would make an array of 8 exabytes of this."""
    before = open_dataset(folder)[0].pattern.labels
    for name in ("labels", "distance", "shape/vertices"):
        header = json.loads((folder / name / "zarr.json").read_text())
        header["shape"] = [1 << 20] * len(header["shape"])
        header["chunk_grid"]["configuration"]["chunk_shape"] = [1 << 20] * len(header["shape"])
        (folder / name / "zarr.json").write_text(json.dumps(header))
    with little_memory():
        assert (open_dataset(folder)[0].pattern.labels == before).all()


RECORDS: dict[str, bytes] = {
    "nested": b"[" * 100_000 + b"]" * 100_000,
    "not an object": b"[1, 2, 3]",
    "not a number": json.dumps({"kind": "failed", "seed": float("nan"), "reason": ""}).encode(),
    "large": b'{"kind": "failed", "reason": "' + b"x" * (2 << 20) + b'"}',
    "not text": bytes(range(256)),
}


@pytest.mark.parametrize("name", RECORDS)
def test_records_that_lie(folder: Path, name: str) -> None:
    (folder / "entries/000001.json").write_bytes(RECORDS[name])
    with little_memory(), pytest.raises(BadInput, match=r"entries/000001\.json: damaged") as caught:
        open_dataset(folder)
    assert "\n" not in str(caught.value)
    data, damaged = verify_dataset(folder)
    assert set(damaged) == {1} and data.tried == 1


def sealed(said: dict) -> bytes:
    seal = hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
    return json.dumps({**said, "sha256": seal}).encode()


def test_a_record_cannot_name_files(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(b"secret")
    about = ObjectInfo.of(b"secret")
    said = read_record(0, (folder / "entries/000000.json").read_bytes()).to_dict()
    said["objects"]["../../secret"] = {"bytes": about.size, "sha256": about.sha256}
    (folder / "entries/000000.json").write_bytes(sealed(said))
    assert set(open_dataset(folder).samples[0].objects) == {"labels", "distance"}


@pytest.mark.parametrize("key", ["labels", "entries", "shape/vertices", "labels/c/0/0/0/0", "entries/000000.json"])
def test_links_that_lead_outside(folder: Path, tmp_path: Path, key: str) -> None:
    outside = tmp_path / "outside"
    shutil.move(folder / key, outside)
    (folder / key).symlink_to(outside)
    with pytest.raises(BadInput, match="leads out of the data set"):
        list(open_dataset(folder))
    before = sorted(tmp_path.rglob("*"))
    if key.startswith("labels"):
        (folder / "entries/000000.json").unlink()  # what is there is not written again
    with pytest.raises(BadInput, match="leads out of the data set"):
        create_dataset(folder, SETTINGS)
        for k in (0, 2):
            write_sample(folder, k, random_sample(np.random.default_rng(0)))
    assert [path for path in sorted(tmp_path.rglob("*")) if outside in path.parents] == [
        path for path in before if outside in path.parents
    ]


def test_a_pipe_is_not_waited_for(folder: Path) -> None:
    path = folder / shard_key("labels", 0)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(BadInput, match="not a file"):
        open_dataset(folder)[0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"shape": {"vertices": 10**12}}, "a mesh of 1000000000000 vertices"),
        ({"shape": {"vertices": -1}}, "a mesh of -1 vertices"),
        ({"shape": {"faces": 4_000_000}}, "not a readable data set"),
        ({"resolution": 1 << 40}, "resolution must be one of"),
        ({"speed_range": [1]}, "not a readable data set"),
        ({"material": {"young": "soft"}}, "not a readable data set"),
        ({"format": 99}, "format 99, this program reads 3"),
    ],
)
def test_manifests_that_lie(folder: Path, change: dict, said: str) -> None:
    about = json.loads((folder / "dataset.json").read_text())
    for name, value in change.items():
        about[name] = about[name] | value if isinstance(value, dict) else value
    (folder / "dataset.json").write_text(json.dumps(about))
    with pytest.raises(BadInput, match=said) as caught:
        open_dataset(folder)
    assert "\n" not in str(caught.value)


def test_a_mesh_that_lies(folder: Path) -> None:
    (folder / mesh_key("faces")).write_bytes(claiming(1 << 45))
    with little_memory(), pytest.raises(BadInput, match="not a readable data set"):
        open_dataset(folder)
