"""The program as a person uses it: simulate, train, shatter, look; and what it says to bad input."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

DATA = Path(__file__).parents[3] / "shared" / "data"


def run(*args: object, cwd: Path | None = None) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "from deepfracture.cli import main; main()", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd)


def done(*args: object) -> str:
    finished = run(*args)
    assert finished.returncode == 0, finished.stderr
    return finished.stderr


def check_output(out: Path) -> dict:
    """The report of a shatter that broke something, after checking that all it names is there and sound."""
    report = json.loads((out / "report.json").read_text())
    assert report["broke"] and report["sigma_1"] > report["strength"]
    assert len(report["fragments"]) >= 2
    assert all(piece["closed"] and piece["volume"] > 0 and piece["mass"] > 0 for piece in report["fragments"])
    assert report["volume_error"] < 0.005
    assert all((out / file).exists() for file in report["files"])
    assert {"cut", "world, with the break"} <= {step["stage"] for step in report["stages"]}
    pieces = [trimesh.load(path, process=False) for path in sorted((out / "fragments").iterdir())]
    assert len(pieces) == len(report["fragments"])
    assert all(piece.is_watertight for piece in pieces)
    assert sum(p.volume for p in pieces) == pytest.approx(sum(p["volume"] for p in report["fragments"]), rel=1e-4)
    return report


@pytest.fixture(scope="module")
def learned(tmp_path_factory) -> Path:
    """A folder with a data set of the bar and a model trained on it for some seconds."""
    folder = tmp_path_factory.mktemp("learned")
    said = done(
        "simulate", "bar", "--collisions", 4, "--resolution", 32, "--speed", 14, 20, "--out", folder / "data",
    )  # fmt: skip
    assert "from 4 collisions" in said
    done("train", folder / "data", "--out", folder / "run", "--minutes", 0.3)
    return folder


@pytest.mark.slow
def test_simulate_train_shatter(learned: Path, tmp_path: Path) -> None:
    model = learned / "run" / "model.safetensors"
    done("shatter", "bar", "--model", model, "--speed", 18, "--no-film", "--out", tmp_path / "out")
    report = check_output(tmp_path / "out")
    assert report["breaker"] == "learned"
    assert {"predict", "segment"} <= {step["stage"] for step in report["stages"]}
    said = done("info", learned / "data") + done("info", model) + done("info", tmp_path / "out" / "report.json")
    assert "data set of bar" in said and "shatter bar" in said


@pytest.mark.slow
def test_simulating_again_adds_only_what_is_missing(learned: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in (learned / "data" / "samples").rglob("*") if path.is_file()}
    done("simulate", "bar", "--collisions", 4, "--resolution", 32, "--speed", 14, 20, "--out", learned / "data")
    after = {path: path.stat().st_mtime_ns for path in (learned / "data" / "samples").rglob("*") if path.is_file()}
    assert before == after


@pytest.mark.slow
@pytest.mark.parametrize("breaker", ["physical", "voronoi", "nearest"])
def test_every_breaker_through_the_one_seam(breaker: str, learned: Path, tmp_path: Path) -> None:
    extra = ["--dataset", learned / "data"] if breaker == "nearest" else []
    done(
        "shatter", "bar", "--breaker", breaker, *extra, "--speed", 18, "--resolution", 32, "--no-film",
        "--out", tmp_path,
    )  # fmt: skip
    assert check_output(tmp_path)["breaker"] == breaker


@pytest.mark.slow
def test_a_file_of_ones_own_comes_back_in_its_own_coordinates(tmp_path: Path) -> None:
    box = trimesh.creation.box((30.0, 6.0, 6.0))
    box.apply_translation((100.0, 0.0, 50.0))
    box.export(tmp_path / "beam.stl")
    done(
        "shatter", tmp_path / "beam.stl", "--breaker", "voronoi", "--resolution", 32, "--speed", 18, "--formats",
        "fragments", "--out", tmp_path / "out",
    )  # fmt: skip
    check_output(tmp_path / "out")
    pieces = [trimesh.load(path, process=False) for path in (tmp_path / "out" / "fragments").iterdir()]
    assert np.allclose(np.min([p.bounds[0] for p in pieces], axis=0), box.bounds[0], atol=1e-4)
    assert np.allclose(np.max([p.bounds[1] for p in pieces], axis=0), box.bounds[1], atol=1e-4)
    assert sum(p.volume for p in pieces) == pytest.approx(box.volume, rel=1e-4)


@pytest.mark.slow
def test_the_scene_that_shatter_writes_replays_the_same(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    same = ("--breaker", "voronoi", "--resolution", 32, "--formats", "glb")
    done("shatter", "bar", *same, "--speed", 18, "--seed", 5, "--out", one)
    done("shatter", "--scene", one / "scene.toml", *same, "--seed", 5, "--out", two)
    assert (one / "animation.glb").read_bytes() == (two / "animation.glb").read_bytes()


def test_a_shape_by_its_other_name(tmp_path: Path) -> None:
    done(
        "shatter", "letter-a", "--breaker", "voronoi", "--resolution", 32, "--speed", 14, "--formats", "fragments",
        "--out", tmp_path,
    )  # fmt: skip
    check_output(tmp_path)


@pytest.mark.slow
def test_it_writes_the_formats_that_are_asked_for_and_no_others(tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    done(
        "shatter", "bar", "--breaker", "voronoi", "--resolution", 32, "--speed", 18, "--out", tmp_path,
        "--formats", "usd", "fragments", "ply-sequence",
    )  # fmt: skip
    files = {"animation.usdc", "fragments", "ply_sequence", "scene.toml", "report.json"}
    assert {path.name for path in tmp_path.iterdir()} == files
    assert {*json.loads((tmp_path / "report.json").read_text())["files"], "report.json"} == files
    pieces = len(list((tmp_path / "fragments").iterdir()))
    assert (tmp_path / "ply_sequence" / "frame_0012.ply").read_bytes().count(b" fragment_") == pieces


def test_a_soft_touch_breaks_nothing_and_says_so(tmp_path: Path) -> None:
    options = ("--breaker", "voronoi", "--resolution", 32, "--no-film", "--out", tmp_path)
    said = done("shatter", "bar", *options, "--speed", 0.3)
    assert "did not break" in said or "nothing touched it" in said
    assert json.loads((tmp_path / "report.json").read_text())["broke"] is False


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["bar"], "no trained model for this shape; try --breaker physical"),
        (["nothing.obj"], "nothing.obj: no such file"),
        (["gargoyle"], "gargoyle"),
        (["bar", "--breaker", "magic"], "choose one of learned, physical, voronoi, nearest"),
        (["bar", "--breaker", "nearest"], "--dataset"),
        (["bar", "--breaker", "physical", "--material", "cheese"], "cheese"),
        (["bar", "--breaker", "physical", "--resolution", "50"], "resolution must be one of"),
        (["bar", "--breaker", "physical", "--up", "w"], "up must be x, y or z"),
        (["bar", "--breaker", "physical", "--engine", "unreal"], "unreal"),
        (["bar", "--breaker", "physical", "--speed", "-3"], "speed and radius must be positive"),
        (["--scene", "none.toml"], "none.toml"),
        (["bar", "--formats", "glb", "usd-a"], "got 'usd-a'; did you mean 'usda'?"),
    ],
)
def test_bad_values_get_one_clear_line(args: list[str], says: str, tmp_path: Path) -> None:
    finished = run("shatter", *args, "--out", tmp_path / "out")
    lines = finished.stderr.strip().splitlines()
    assert finished.returncode == 2
    assert says in lines[-1]
    assert "Traceback" not in finished.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("empty.obj", "", "empty"),
        ("letter.obj", "Dear reader,\nthis is not a mesh.\n", "no triangles"),
        ("nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n", "NaN"),
        ("mesh.xyz", "1 2 3", "xyz"),
    ],
)
def test_bad_files_get_one_clear_line(name: str, content: str, says: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    finished = run("shatter", name, "--breaker", "physical", "--out", "out", cwd=tmp_path)
    assert finished.returncode == 2
    assert len(finished.stderr.strip().splitlines()) == 1
    assert name in finished.stderr and says in finished.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not DATA.exists(), reason="the shared meshes are not here")
def test_an_open_mesh_is_refused_with_counts_and_broken_when_repaired(tmp_path: Path) -> None:
    finished = run("shatter", DATA / "teapot.obj", "--breaker", "voronoi", "--out", tmp_path / "out")
    assert finished.returncode == 2
    assert "4 open shells" in finished.stderr and "try --repair" in finished.stderr
    done(
        "shatter", DATA / "teapot.obj", "--repair", "--breaker", "voronoi", "--up", "y", "--speed", 20, "--formats",
        "fragments", "--out", tmp_path / "out",
    )  # fmt: skip
    check_output(tmp_path / "out")
