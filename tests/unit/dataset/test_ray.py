"""A data set filled by Ray: a real cluster of one node. `benchmarks/cluster.py` has two, kills one and poisons some."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from deepfracture.dataset import Dataset, Local, RayCluster, SimulateOptions, recorded, simulate_collisions
from deepfracture.runtime import extras
from deepfracture.types import BadInput
from tests.tools.synthetic import CLAY, TETRAHEDRON, fake_collisions, unready

pytest.importorskip("ray", reason="ray is not installed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[RayCluster]:
    import ray

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_MODE", "disabled")  # on the loopback; else a token is written to the home folder
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))  # the workers import tests.tools.synthetic
        ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=100_000_000)
        yield RayCluster("auto", None)
        ray.shutdown()


def run(out: Path, executor: Local | RayCluster, **changes) -> Dataset:
    make_simulator = changes.pop("make_simulator", fake_collisions)
    options = SimulateOptions(**({"collisions": 8, "resolution": 32, "seed": 3, "speed": (1.0, 9.0)} | changes))
    return simulate_collisions(TETRAHEDRON, CLAY, out, options, executor=executor, make_simulator=make_simulator)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_a_cluster_writes_the_same_bytes(cluster: RayCluster, tmp_path: Path) -> None:
    assert run(tmp_path / "ray", cluster).tried == 8
    run(tmp_path / "local", Local(1))
    assert contents(tmp_path / "ray") == contents(tmp_path / "local")


@pytest.mark.slow
def test_an_error_that_is_no_entrys_comes_back_in_one_piece(cluster: RayCluster, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"^a worker failed: oven: too cold"):
        run(tmp_path / "ray", cluster, make_simulator=unready)
    assert recorded(tmp_path / "ray") == set()


def test_what_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = extras.is_installed
    monkeypatch.setattr(extras, "is_installed", lambda module: module != "ray" and there(module))
    with pytest.raises(BadInput, match=r"ray is needed .* pip install 'deepfracture\[ray\]'"):
        run(tmp_path / "set", RayCluster("auto", None))
