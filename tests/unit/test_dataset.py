"""The folder of simulated collisions: whole, the same whatever happens, refused when damaged."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from deepfracture.carve import cut
from deepfracture.dataset import Outcome, Sample, generate, open_dataset, simulate_collisions, store
from deepfracture.dataset.refracture import leaves, pattern_of
from deepfracture.geometry import builtin, signed_distance
from deepfracture.types import (
    BadInput,
    FracturePattern,
    Fragment,
    Fragments,
    Grid,
    Impact,
    Material,
    Mesh,
    NoSolution,
    Recording,
    Shape,
)
from deepfracture.world import Collision, Motion
from deepfracture.world import Outcome as Ran

CLAY = Material("clay", 40e9, 0.2, 2200.0, 28e6, 0.9e6, 10.0)
TETRAHEDRON = Shape(
    "tetrahedron",
    Mesh([[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


def random_sample(rng: np.random.Generator, resolution: int = 32) -> Sample:
    direction = rng.normal(size=(2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    magnitude = np.sort(rng.uniform(1, 100, 2))[::-1]
    impact = Impact(rng.uniform(-1, 1, (2, 3)), direction, magnitude, -direction, float(rng.uniform(1, 9)), 0.2)
    grid = Grid(resolution)
    labels = np.repeat(rng.integers(0, 5, (2, *grid.shape[1:])), resolution // 2, axis=0)
    distance = rng.uniform(0, 1, grid.shape).astype(np.float16)
    return Sample(impact, FracturePattern(grid, labels, distance), int(rng.integers(1 << 60)))


def fake_collisions(settings: store.Settings):
    """Stands in for world and simulator: a third of the balls break nothing, some miss."""

    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> Outcome:
        kind = rng.integers(6)
        sample = random_sample(rng, settings.resolution)
        return Outcome(None if kind == 0 else sample.impact, None if kind < 2 else sample.pattern)

    return collide


def failing_collisions(settings: store.Settings):
    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> Outcome:
        raise ZeroDivisionError("ball: too round")

    return collide


def stubborn_collisions(settings: store.Settings):
    """As `fake_collisions`, but every fourth or so cannot be solved."""
    simple = fake_collisions(settings)

    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> Outcome:
        if rng.random() < 0.25:
            raise NoSolution("the stress did not converge")
        return simple(rng)

    return collide


def run(out: Path, **changes):
    options = {"collisions": 8, "workers": 1, "resolution": 32, "seed": 3, "speed_range": (1.0, 9.0)}
    options = options | {"prepare": fake_collisions} | changes
    return simulate_collisions(TETRAHEDRON, CLAY, out, **options)


def digests(folder: Path) -> dict[str, str]:
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "set"
    run(folder)
    return folder


def test_a_sample_comes_back_as_it_was_stored(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    settings = store.Settings(TETRAHEDRON, CLAY, 32, 0, (1.0, 9.0))
    store.create(tmp_path / "set", settings)
    sample = random_sample(rng)
    store.write_sample(tmp_path / "set", 4, sample)
    store.write_unbroken(tmp_path / "set", 2, sample.impact, 77)
    found = open_dataset(tmp_path / "set")
    assert (len(found), found.tried, found.unbroken) == (1, 2, 1)
    assert found.max_impulse == sample.impact.magnitude[0]
    assert found.material == CLAY and found.shape.name == "tetrahedron"
    assert (found.shape.mesh.vertices == TETRAHEDRON.mesh.vertices).all()
    back = found[0]
    assert (back.pattern.labels == sample.pattern.labels).all()
    assert (back.pattern.distance == sample.pattern.distance).all()
    assert back.seed == sample.seed and back.impact.speed == sample.impact.speed
    for name in store.IMPACT_FIELDS:
        assert (getattr(back.impact, name) == getattr(sample.impact, name)).all()


def test_many_labels_are_kept(tmp_path: Path) -> None:
    store.create(tmp_path / "set", store.Settings(TETRAHEDRON, CLAY, 32, 0, (1.0, 9.0)))
    labels = np.arange(32**3).reshape(32, 32, 32) % 300
    sample = random_sample(np.random.default_rng(0))
    pattern = FracturePattern(Grid(32), labels, np.ones((32, 32, 32)))
    store.write_sample(tmp_path / "set", 0, Sample(sample.impact, pattern, 0))
    assert (open_dataset(tmp_path / "set")[0].pattern.labels == labels).all()


def test_a_sample_that_was_being_written_does_not_count(tmp_path: Path, finished: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(finished, folder)
    whole = sorted((folder / "samples").iterdir())[0]
    k = int(whole.name)
    whole.rename(whole.with_name(f".{whole.name}.123"))
    assert len(open_dataset(folder)) == len(open_dataset(finished)) - 1
    assert k not in store.done(folder)


def test_counts_say_what_was_tried(finished: Path) -> None:
    found = open_dataset(finished)
    assert found.tried == 8 and 0 < found.unbroken < 8
    assert store.done(finished) == set(range(8))


def test_the_number_of_workers_changes_no_byte(tmp_path: Path, finished: Path) -> None:
    run(tmp_path / "set", workers=2)
    assert digests(tmp_path / "set") == digests(finished)


def test_only_missing_collisions_are_done_again(tmp_path: Path, finished: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(finished, folder)
    kept = sorted((folder / "samples").iterdir())
    shutil.rmtree(kept[0])
    next((folder / "unbroken").iterdir()).unlink()
    before = kept[1].joinpath("zarr.json").stat().st_mtime_ns
    run(folder)
    assert digests(folder) == digests(finished)
    assert kept[1].joinpath("zarr.json").stat().st_mtime_ns == before


def test_a_finished_set_starts_no_worker(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generate, "ProcessPoolExecutor", None)
    assert run(finished).tried == 8


def test_an_error_in_a_worker_reaches_the_caller(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError, match="ball: too round"):
        run(tmp_path / "set", prepare=failing_collisions)


def test_what_the_solver_cannot_take_is_counted_and_passed_over(tmp_path: Path) -> None:
    data = run(tmp_path / "set", collisions=24, prepare=stubborn_collisions)
    assert 0 < data.failed < 12
    assert data.tried == 24 == len(data) + data.unbroken + data.failed
    reasons = [json.loads(path.read_text())["reason"] for path in (tmp_path / "set" / "failed").iterdir()]
    assert reasons == ["the stress did not converge"] * data.failed
    before = digests(tmp_path / "set")
    run(tmp_path / "set", collisions=24, prepare=failing_collisions)  # nothing is left to do
    assert digests(tmp_path / "set") == before


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seed": 4}, "another seed: 3, not 4"),
        ({"resolution": 64}, "another resolution: 32, not 64"),
        ({"speed_range": (1.0, 8.0)}, "another speed_range"),
        ({"scene": "dual"}, "another scene: single, not dual"),
        ({"refracture": 2}, "another refracture: 0, not 2"),
    ],
)
def test_other_settings_are_refused_in_one_line(finished: Path, changes: dict, words: str) -> None:
    with pytest.raises(BadInput, match=words) as caught:
        run(finished, **changes)
    assert "\n" not in str(caught.value)


def test_another_material_is_named_by_the_property_that_differs(finished: Path) -> None:
    stiff = Material("clay", 41e9, 0.2, 2200.0, 28e6, 0.9e6, 10.0)
    with pytest.raises(BadInput, match="another material young"):
        simulate_collisions(
            TETRAHEDRON, stiff, finished, collisions=8, workers=1, resolution=32, seed=3, speed_range=(1, 9)
        )


def test_sets_of_format_one_are_of_single_balls(tmp_path: Path, finished: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(finished, folder)
    manifest = folder / "dataset.json"
    values = json.loads(manifest.read_text()) | {"format": 1}
    for name in store.UNSAID:
        del values[name]
    manifest.write_text(json.dumps(values))
    assert open_dataset(folder).settings.scene == "single"
    assert run(folder, collisions=9).tried == 9
    with pytest.raises(BadInput, match="another scene: single, not shear"):
        run(folder, scene="shear")


def repeated_collisions(settings: store.Settings):
    def collide(rng: np.random.Generator, again: np.random.Generator | None = None) -> Outcome:
        impact = random_sample(rng, settings.resolution).impact
        return Outcome(impact, random_sample(again or rng, settings.resolution).pattern)

    return collide


def test_repeats_share_the_impact_but_not_the_material(tmp_path: Path) -> None:
    plain = run(tmp_path / "plain", collisions=3, prepare=repeated_collisions)
    made = run(tmp_path / "repeated", collisions=3, repeats=2, prepare=repeated_collisions)
    assert made.collisions() == [(0, 1), (2, 3), (4, 5)]
    assert plain.collisions() == [(0,), (1,), (2,)]
    for once, (first, second) in zip(plain, made.collisions(), strict=True):
        assert np.array_equal(made[first].pattern.labels, once.pattern.labels)
        assert np.array_equal(made[first].impact.magnitude, made[second].impact.magnitude)
        assert not np.array_equal(made[first].pattern.labels, made[second].pattern.labels)


def test_frames_count_only_with_refracture(tmp_path: Path, finished: Path) -> None:
    assert run(finished, frames=30).tried == 8
    made = run(tmp_path / "set", collisions=1, refracture=1, frames=30)
    assert (made.settings.refracture, made.settings.frames) == (1, 30)
    with pytest.raises(BadInput, match="another frames: 30, not 60"):
        run(tmp_path / "set", collisions=1, refracture=1)


def test_fragments_become_the_pattern_that_they_were_cut_from() -> None:
    shape = builtin("bar")
    points = np.random.default_rng(1).uniform(-1, 1, (9, 3)) * [1, 0.2, 0.2]
    grid = Grid(64)
    centres = grid.centres()
    apart = np.linalg.norm(centres[..., None, :] - points, axis=-1)
    inside = signed_distance(shape.mesh, grid) > 0
    labels = np.where(inside, apart.argmin(axis=-1) + 1, 0)
    # Distance to the plane between the two nearest points, which is the crack.
    order = np.argsort(apart, axis=-1)
    near, next_ = points[order[..., 0]], points[order[..., 1]]
    gap = np.abs(apart.min(axis=-1) ** 2 - np.sort(apart, axis=-1)[..., 1] ** 2) / (
        2 * np.linalg.norm(near - next_, axis=-1)
    )
    pattern = FracturePattern(grid, labels, np.where(inside, gap, 0.0))
    pieces = list(cut(shape, pattern, density=1000.0))
    found = pattern_of(pieces, pattern)
    assert ((found.labels > 0) == (labels > 0)).all()  # every voxel once, no other
    assert found.count == len(pieces)
    agree = [np.bincount(labels[found.labels == n]).max() for n in range(1, found.count + 1)]
    assert sum(agree) > 0.98 * inside.sum()
    close = inside & (gap < 0.1)
    assert np.median(np.abs(found.distance - gap)[close]) < 0.25 * grid.spacing


def test_leaves_are_what_did_not_break_again() -> None:
    def piece(x: float) -> Fragment:
        mesh = TETRAHEDRON.mesh.moved(1.0, [x, 0, 0])
        return Fragment(mesh, np.arange(4), 1.0, np.zeros(3), np.eye(3))

    still = Motion(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    impact = random_sample(np.random.default_rng(0)).impact

    def collision(body: str, generation: int, *places: float) -> Collision:
        pieces = Fragments(tuple(map(piece, places))) if places else None
        return Collision(body, TETRAHEDRON, 0.1, 6, impact, still, still, pieces, generation)

    done = (
        collision("shape0", 0, 0.0, 10.0, 20.0),
        collision("shape0.001", 1),
        collision("shape0.001", 1, 11.0, 12.0),
        collision("shape0.001.000", 2, 11.1, 11.2),
    )
    left = leaves(Ran(Recording(1 / 60, ()), done))
    assert [round(float(p.mesh.vertices[0, 0]) + 1, 6) for p in left] == [0.0, 11.1, 11.2, 12.0, 20.0]


def test_a_kind_of_scene_is_remembered(tmp_path: Path) -> None:
    assert run(tmp_path / "set", collisions=2, scene="points").settings.scene == "points"
    assert open_dataset(tmp_path / "set").settings.scene == "points"


@pytest.mark.parametrize(
    "changes", [{"collisions": 0}, {"workers": 0}, {"speed_range": (5.0, 2.0)}, {"scene": "triple"}]
)
def test_senseless_values_are_refused(tmp_path: Path, changes: dict) -> None:
    with pytest.raises(BadInput):
        run(tmp_path / "set", **changes)
    assert not (tmp_path / "set").exists()


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "holiday.jpg").write_text("sun")
    with pytest.raises(BadInput, match="not a data set"):
        run(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["holiday.jpg"]


@pytest.mark.parametrize("damage", ["missing", "text", "json", "format", "mesh"])
def test_a_damaged_manifest_is_one_line(tmp_path: Path, finished: Path, damage: str) -> None:
    folder = tmp_path / "set"
    shutil.copytree(finished, folder)
    manifest = folder / "dataset.json"
    if damage == "missing":
        manifest.unlink()
    elif damage == "mesh":
        shutil.rmtree(folder / "shape")
    else:
        values = json.loads(manifest.read_text()) | {"format": 99}
        manifest.write_text({"text": "hello", "json": "{}", "format": json.dumps(values)}[damage])
    with pytest.raises(BadInput) as caught:
        open_dataset(folder)
    assert str(folder) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("damage", ["chunk", "attributes"])
def test_a_damaged_sample_is_one_line(tmp_path: Path, finished: Path, damage: str) -> None:
    folder = tmp_path / "set"
    shutil.copytree(finished, folder)
    sample = sorted((folder / "samples").iterdir())[0]
    if damage == "chunk":
        chunk = next(path for path in (sample / "labels").rglob("*") if path.is_file() and path.name != "zarr.json")
        chunk.write_bytes(b"nonsense")
    else:
        (sample / "zarr.json").write_text("{}")
    with pytest.raises(BadInput, match="damaged sample") as caught:
        open_dataset(folder)[0]
    assert "\n" not in str(caught.value)
