"""Data sets in a bucket, on a real S3 server that runs on this machine."""

from __future__ import annotations

import hashlib
import logging
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest

from deepfracture.dataset import (
    Dataset,
    DatasetSettings,
    Local,
    SimulateOptions,
    copy_dataset,
    create_dataset,
    open_dataset,
    simulate_collisions,
    storage,
    verify_dataset,
)
from deepfracture.dataset.storage import open_storage
from deepfracture.runtime import extras
from deepfracture.types import BadInput
from tests.tools.synthetic import CLAY, TETRAHEDRON, fake_collisions

moto = pytest.importorskip("moto.server", reason="moto, the S3 server of these tests, is not installed")
obstore = pytest.importorskip("obstore", reason="obstore, which talks to buckets, is not installed")
SETTINGS = DatasetSettings(TETRAHEDRON, CLAY, 32, 3, (1.0, 9.0))


@pytest.fixture(scope="module", autouse=True)
def bucket() -> Iterator[None]:
    """A bucket named `data`, where the environment says."""
    server = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    logging.getLogger("werkzeug").setLevel(logging.WARNING)  # it tells of every request
    endpoint = "http://{}:{}".format(*server.get_host_and_port())
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "AWS_ENDPOINT_URL": endpoint,
            "AWS_REGION": "us-east-1",
            "AWS_ACCESS_KEY_ID": "testing",
            "AWS_SECRET_ACCESS_KEY": "testing",
        }.items():
            patch.setenv(name, value)
        urllib.request.urlopen(urllib.request.Request(f"{endpoint}/data", method="PUT"))
        yield
    server.stop()


def run(place: Path | str, collisions: int = 8, **changes) -> Dataset:
    executor = changes.pop("executor", Local(2))
    options = SimulateOptions(
        **({"collisions": collisions, "resolution": 32, "seed": 3, "speed": (1.0, 9.0)} | changes)
    )
    return simulate_collisions(TETRAHEDRON, CLAY, place, options, executor=executor, make_simulator=fake_collisions)


def objects(place: Path | str) -> dict[str, str]:
    """Hash of every object, by its key."""
    if isinstance(place, Path):
        files = [path for path in place.rglob("*") if path.is_file()]
        return {path.relative_to(place).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    from obstore.store import S3Store

    there = S3Store("data", prefix=place.removeprefix("s3://data/"), client_options={"allow_http": True})
    keys = [found["path"] for page in obstore.list(there) for found in page]
    return {key: hashlib.sha256(obstore.get(there, key).bytes()).hexdigest() for key in keys}


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "set"
    run(folder)
    return folder


@pytest.fixture(scope="module")
def remote(bucket: None) -> str:
    run("s3://data/sets/one")
    return "s3://data/sets/one"


def test_a_bucket_holds_the_bytes_of_a_folder(local: Path, remote: str) -> None:
    assert objects(remote) == objects(local)
    data = open_dataset(Path(remote))  # a Path has made one slash of two
    assert data.path == remote and data.name == "one"
    assert (data[0].pattern.labels == open_dataset(local)[0].pattern.labels).all()


def test_everybody_can_read_the_arrays(local: Path, remote: str) -> None:
    import zarr
    from obstore.store import S3Store
    from zarr.storage import ObjectStore

    there = S3Store("data", prefix="sets/one", client_options={"allow_http": True})
    group = zarr.open_group(ObjectStore(there, read_only=True), mode="r")
    record = open_dataset(local).samples[0]
    assert (group["labels"][record.number] == open_dataset(local)[0].pattern.labels).all()


def test_it_goes_on_where_it_stopped(remote: str) -> None:
    first = objects(remote)
    assert run(remote, collisions=10).tried == 10
    later = objects(remote)
    assert {key: later[key] for key in first} == first and len(later) > len(first)


def test_both_ways_and_back(tmp_path: Path, local: Path) -> None:
    there, damaged = copy_dataset(local, "s3://data/copies/there")
    assert damaged == 0 and there.tried == 8
    copy_dataset("s3://data/copies/there", tmp_path / "back")
    assert objects(tmp_path / "back") == objects(local)


def test_of_two_starts_with_other_settings_one_is_refused() -> None:
    def start(seed: int) -> str:
        try:
            create_dataset("s3://data/race/set", replace(SETTINGS, seed=seed))
        except BadInput as problem:
            return str(problem)
        return ""

    with ThreadPoolExecutor(6) as threads:
        said = list(threads.map(start, range(6)))
    assert sum(not words for words in said) == 1
    assert open_dataset("s3://data/race/set").settings.seed == said.index("")


def test_damage_is_named_and_mended(local: Path) -> None:
    from deepfracture.dataset.arrays import shard_key

    data, _ = copy_dataset(local, "s3://data/copies/damaged")
    record = data.samples[0]
    data.storage.write(shard_key("distance", record.number), b"nonsense")
    data.storage.delete(shard_key("labels", data.samples[1].number))
    assert set(verify_dataset(data.path)[1]) == {record.number, data.samples[1].number}
    run(data.path, retry=True)
    assert objects(data.path) == objects(local)


def test_what_is_too_large_is_not_fetched() -> None:
    where = open_storage("s3://data/large")
    where.write("object", b"0" * 1001)
    with pytest.raises(BadInput, match="1001 bytes, more than the 1000"):
        where.read("object", 1000)
    assert len(where.read("object", 1001) or b"") == 1001


def test_a_bucket_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for wrong in (lambda: create_dataset("s3://nobody/set", SETTINGS), lambda: run("s3://nobody/set")):
        with pytest.raises(BadInput, match=r"s3://nobody/set: cannot be .*bucket does not exist") as caught:
            wrong()
        assert "\n" not in str(caught.value)
    with pytest.raises(BadInput, match="not a data set"):
        open_dataset("s3://data/nothing")
    monkeypatch.setattr(storage, "RETRY_TIMEOUT", timedelta(seconds=0.2))
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(BadInput, match="AWS_ENDPOINT_URL") as caught:
        open_dataset("s3://data/sets/one")
    assert "\n" not in str(caught.value)


def test_what_reads_buckets_is_named_when_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    there = extras.is_installed
    monkeypatch.setattr(extras, "is_installed", lambda module: module != "obstore" and there(module))
    with pytest.raises(BadInput, match=r"obstore is needed .* pip install 'deepfracture\[s3\]'"):
        open_dataset("s3://data/sets/one")
