"""The folder of simulated collisions: whole, the same whatever happens, refused when damaged."""

from __future__ import annotations

import hashlib
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture.carve import cut
from deepfracture.dataset import (
    DatasetSettings,
    Local,
    Sample,
    SimulateOptions,
    copy_dataset,
    create_dataset,
    make_executor,
    open_dataset,
    recorded,
    simulate_collisions,
    verify_dataset,
    write_sample,
    write_unbroken,
)
from deepfracture.dataset.arrays import PATTERN_ARRAYS, shard_key
from deepfracture.dataset.record import IMPACT_FIELDS, Record
from deepfracture.dataset.refracture import final_fragments, voxelize
from deepfracture.dataset.storage import open_storage
from deepfracture.geometry import builtin, signed_distance
from deepfracture.types import (
    BadInput,
    FracturePattern,
    Fragment,
    Fragments,
    Grid,
    Material,
    Recording,
)
from deepfracture.world import BodyState, Collision
from deepfracture.world import Outcome as Ran
from tests.tools.synthetic import (
    CLAY,
    TETRAHEDRON,
    failing_collisions,
    fake_collisions,
    killed_once,
    poisoned_collisions,
    random_sample,
    repeated_collisions,
    stubborn_collisions,
    unready,
)


def run(out: Path, **changes):
    executor, make_simulator = changes.pop("executor", Local(1)), changes.pop("make_simulator", fake_collisions)
    options = SimulateOptions(**({"collisions": 8, "resolution": 32, "seed": 3, "speed": (1.0, 9.0)} | changes))
    return simulate_collisions(TETRAHEDRON, CLAY, out, options, executor=executor, make_simulator=make_simulator)


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
    settings = DatasetSettings(TETRAHEDRON, CLAY, 32, 0, (1.0, 9.0))
    create_dataset(tmp_path / "set", settings)
    sample = random_sample(rng)
    write_sample(tmp_path / "set", 4, sample)
    write_unbroken(tmp_path / "set", 2, sample.impact, 77)
    found = open_dataset(tmp_path / "set")
    assert (len(found), found.tried, found.unbroken) == (1, 2, 1)
    assert found.max_impulse == sample.impact.magnitude[0]
    assert found.material == CLAY and found.shape.name == "tetrahedron"
    assert (found.shape.mesh.vertices == TETRAHEDRON.mesh.vertices).all()
    back = found[0]
    assert (back.pattern.labels == sample.pattern.labels).all()
    assert (back.pattern.distance == sample.pattern.distance).all()
    assert back.seed == sample.seed and back.impact.speed == sample.impact.speed
    for name in IMPACT_FIELDS:
        assert (getattr(back.impact, name) == getattr(sample.impact, name)).all()


def test_many_labels_are_kept(tmp_path: Path) -> None:
    create_dataset(tmp_path / "set", DatasetSettings(TETRAHEDRON, CLAY, 32, 0, (1.0, 9.0)))
    labels = np.arange(32**3).reshape(32, 32, 32) % 300
    sample = random_sample(np.random.default_rng(0))
    pattern = FracturePattern(Grid(32), labels, np.ones((32, 32, 32)))
    write_sample(tmp_path / "set", 0, Sample(sample.impact, pattern, 0))
    assert (open_dataset(tmp_path / "set")[0].pattern.labels == labels).all()


def test_everybody_can_read_the_arrays(finished: Path) -> None:
    import zarr

    found, data = zarr.open(finished, mode="r"), open_dataset(finished)
    for record, sample in zip(data.samples, data, strict=True):
        assert (found["labels"][record.number] == sample.pattern.labels).all()
        assert (found["distance"][record.number] == sample.pattern.distance).all()
    assert (found["shape/faces"][:] == TETRAHEDRON.mesh.faces).all()


@pytest.mark.parametrize("resolution", [32, 128])
def test_a_pattern_of_any_size_is_kept(tmp_path: Path, resolution: int) -> None:
    """Of several chunks, one of them empty; an array that is zero throughout has no object at all."""
    import zarr

    grid = Grid(resolution)
    labels, distance = np.zeros(grid.shape, int), np.zeros(grid.shape, np.float16)
    labels[: resolution // 2, 3:, :] = np.random.default_rng(0).integers(1, 9, labels[: resolution // 2, 3:].shape)
    storage = create_dataset(tmp_path / "set", DatasetSettings(TETRAHEDRON, CLAY, resolution, 0, (1.0, 9.0)))
    impact = random_sample(np.random.default_rng(0)).impact
    write_sample(storage, 7, Sample(impact, FracturePattern(grid, labels, distance), 0))
    found = open_dataset(storage)[0].pattern
    assert (found.labels == labels).all() and (found.distance == 0).all()
    assert (zarr.open(tmp_path / "set", mode="r")["labels"][7] == labels).all()
    assert not (tmp_path / "set" / shard_key("distance", 7)).exists()


def test_an_entry_without_its_record_does_not_count(tmp_path: Path, finished: Path) -> None:
    """The record is written last, so this is what a kill leaves."""
    folder = tmp_path / "set"
    shutil.copytree(finished, folder)
    record = open_dataset(folder).samples[0]
    (folder / record.key).unlink()
    assert len(open_dataset(folder)) == len(open_dataset(finished)) - 1
    assert record.number not in recorded(folder)
    run(folder)
    assert digests(folder) == digests(finished)


def test_counts_say_what_was_tried(finished: Path) -> None:
    found = open_dataset(finished)
    assert found.tried == 8 and 0 < found.unbroken < 8
    assert recorded(finished) == set(range(8))


def test_the_number_of_workers_changes_no_byte(tmp_path: Path, finished: Path) -> None:
    run(tmp_path / "set", executor=Local(2))
    assert digests(tmp_path / "set") == digests(finished)


def test_only_missing_collisions_are_done_again(tmp_path: Path, finished: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(finished, folder)
    data = open_dataset(folder)
    first, second = data.samples[:2]
    none = next(record for record in data.records if record.kind == "unbroken")
    for record in (first, none):
        (folder / record.key).unlink()
    (folder / shard_key("labels", first.number)).unlink()
    before = (folder / shard_key("labels", second.number)).stat().st_mtime_ns
    run(folder)
    assert digests(folder) == digests(finished)
    assert (folder / shard_key("labels", second.number)).stat().st_mtime_ns == before


def test_a_finished_set_starts_no_worker(finished: Path) -> None:
    assert run(finished, executor=object()).tried == 8


def test_a_start_that_fails_reaches_the_caller(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="oven: too cold"):
        run(tmp_path / "set", make_simulator=unready)
    assert recorded(tmp_path / "set") == set()


def test_poisoned_collisions_are_recorded_and_passed_over(tmp_path: Path) -> None:
    found = run(
        tmp_path / "set", collisions=8, executor=Local(2), make_simulator=poisoned_collisions, limit=15.0, memory=0.6
    )
    reasons = {record.number: record.reason for record in found.records if record.kind == "failed"}
    assert reasons[0] == "took longer than 15 s"
    assert reasons[1] == "took more than 0.6 GB"
    assert reasons[2].startswith("the worker died (exit status -9)")
    assert reasons[3] == "IndexError: out of plates"
    assert found.tried == 8 and found.failed == 4
    run(tmp_path / "set", executor=Local(2), retry=True)
    run(tmp_path / "whole")
    assert digests(tmp_path / "set") == digests(tmp_path / "whole")


def test_a_killed_worker_costs_no_sample(tmp_path: Path) -> None:
    clay = replace(CLAY, name=str(tmp_path / "trace"))
    options, one = SimulateOptions(collisions=6, resolution=32, seed=3, speed=(1.0, 9.0)), Local(1)
    made = simulate_collisions(TETRAHEDRON, clay, tmp_path / "set", options, executor=one, make_simulator=killed_once)
    assert Path(clay.name).exists() and made.tried == 6 and made.failed == 0
    simulate_collisions(TETRAHEDRON, clay, tmp_path / "quiet", options, executor=one, make_simulator=fake_collisions)
    assert digests(tmp_path / "set") == digests(tmp_path / "quiet")


def test_two_jobs_fill_one_set(tmp_path: Path, finished: Path) -> None:
    """They start at once, with nothing there, and share the work."""
    with ThreadPoolExecutor(2) as threads:
        for one in [threads.submit(run, tmp_path / "set") for _ in range(2)]:
            assert one.result().tried == 8
    assert digests(tmp_path / "set") == digests(finished)


def test_of_two_starts_with_other_settings_one_is_refused(tmp_path: Path) -> None:
    def start(seed: int) -> str:
        try:
            create_dataset(tmp_path / "set", DatasetSettings(TETRAHEDRON, CLAY, 32, seed, (1.0, 9.0)))
        except BadInput as problem:
            return str(problem)
        return ""

    with ThreadPoolExecutor(8) as threads:
        said = list(threads.map(start, range(8)))
    assert sum(not words for words in said) == 1
    assert all("made with another seed" in words for words in said if words)
    assert open_dataset(tmp_path / "set").settings.seed == said.index("")


def test_a_start_that_was_killed_is_finished_by_the_next(tmp_path: Path, finished: Path) -> None:
    (tmp_path / "set").mkdir()
    shutil.copy(finished / "dataset.json", tmp_path / "set")
    with pytest.raises(BadInput, match="the simulate command that started it"):
        open_dataset(tmp_path / "set")
    run(tmp_path / "set")
    assert digests(tmp_path / "set") == digests(finished)


def test_what_the_solver_cannot_take_is_counted_and_passed_over(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    data = run(tmp_path / "set", collisions=24, make_simulator=stubborn_collisions)
    assert f"{data.failed} of 24 collisions failed: the stress did not converge" in caplog.text
    assert 0 < data.failed < 12
    assert data.tried == 24 == len(data) + data.unbroken + data.failed
    reasons = [record.reason for record in data.records if record.kind == "failed"]
    assert reasons == ["the stress did not converge"] * data.failed
    before = digests(tmp_path / "set")
    run(tmp_path / "set", collisions=24, make_simulator=failing_collisions)  # nothing is left to do
    assert digests(tmp_path / "set") == before


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seed": 4}, "another seed: 3, not 4"),
        ({"resolution": 64}, "another resolution: 32, not 64"),
        ({"speed": (1.0, 8.0)}, "another speed_range"),
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
            TETRAHEDRON, stiff, finished, SimulateOptions(collisions=8, resolution=32, seed=3, speed=(1, 9))
        )


def test_repeats_share_the_impact_but_not_the_material(tmp_path: Path) -> None:
    plain = run(tmp_path / "plain", collisions=3, make_simulator=repeated_collisions)
    made = run(tmp_path / "repeated", collisions=3, repeats=2, make_simulator=repeated_collisions)
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
    found = voxelize(pieces, pattern)
    assert ((found.labels > 0) == (labels > 0)).all()  # every voxel once, no other
    assert found.count == len(pieces)
    agree = [np.bincount(labels[found.labels == n]).max() for n in range(1, found.count + 1)]
    assert sum(agree) > 0.98 * inside.sum()
    close = inside & (gap < 0.1)
    assert np.median(np.abs(found.distance - gap)[close]) < 0.25 * grid.spacing


def test_final_fragments_are_those_that_did_not_break_again() -> None:
    def piece(x: float) -> Fragment:
        mesh = TETRAHEDRON.mesh.moved(1.0, [x, 0, 0])
        return Fragment(mesh, np.arange(4), 1.0, np.zeros(3), np.eye(3))

    still = BodyState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
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
    left = final_fragments(Ran(Recording(1 / 60, ()), done))
    assert [round(float(p.mesh.vertices[0, 0]) + 1, 6) for p in left] == [0.0, 11.1, 11.2, 12.0, 20.0]


def test_a_kind_of_scene_is_remembered(tmp_path: Path) -> None:
    assert run(tmp_path / "set", collisions=2, scene="points").settings.scene == "points"
    assert open_dataset(tmp_path / "set").settings.scene == "points"


@pytest.mark.parametrize(
    "changes",
    [
        {"collisions": 0},
        {"collisions": 10**6, "repeats": 2},
        {"speed": (5.0, 2.0)},
        {"scene": "triple"},
        {"limit": 0.0},
        {"memory": -1.0},
    ],
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


def damaged_copy(finished: Path, folder: Path, damage: str) -> Record:
    shutil.copytree(finished, folder)
    record = open_dataset(folder).samples[1]
    shard, note = folder / shard_key("labels", record.number), folder / record.key
    if damage == "gone":
        shard.unlink()
    elif damage == "bit":
        data = bytearray(shard.read_bytes())
        data[len(data) // 2] ^= 1
        shard.write_bytes(data)
    elif damage == "swapped":
        shutil.copy(folder / shard_key("labels", open_dataset(folder).samples[0].number), shard)
    elif damage == "record":
        note.write_text(note.read_text().replace('"speed": ', '"speed": 1'))
    elif damage == "empty record":
        note.write_text("")
    return record


@pytest.mark.parametrize("damage", ["gone", "bit", "swapped"])
def test_a_damaged_sample_is_one_line(tmp_path: Path, finished: Path, damage: str) -> None:
    record = damaged_copy(finished, tmp_path / "set", damage)
    with pytest.raises(BadInput, match=f"entry {record.name}: damaged sample .* --retry") as caught:
        open_dataset(tmp_path / "set")[1]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("damage", ["gone", "bit", "swapped", "record", "empty record"])
def test_info_names_what_is_damaged_and_retry_mends_it(
    tmp_path: Path, finished: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    from deepfracture.cli.info import info

    record = damaged_copy(finished, tmp_path / "set", damage)
    with caplog.at_level("INFO", "deepfracture"):
        info(str(tmp_path / "set"))
    assert f"entry {record.name} is damaged" in caplog.text and "--retry" in caplog.text
    assert set(verify_dataset(tmp_path / "set")[1]) == {record.number}
    run(tmp_path / "set", retry=True)
    assert digests(tmp_path / "set") == digests(finished)


def test_a_copy_is_the_same_bytes_and_goes_on(tmp_path: Path, finished: Path) -> None:
    (tmp_path / "new").mkdir()
    shutil.copy(finished / "dataset.json", tmp_path / "new")  # of a copy that was killed
    made, damaged = copy_dataset(finished, tmp_path / "new")
    assert made.tried == 8 and damaged == 0
    assert digests(tmp_path / "new") == digests(finished)
    with pytest.raises(BadInput, match="onto itself"):
        copy_dataset(finished, finished)


def test_a_copy_leaves_out_what_is_damaged(tmp_path: Path, finished: Path) -> None:
    record = damaged_copy(finished, tmp_path / "set", "bit")
    made, damaged = copy_dataset(tmp_path / "set", tmp_path / "new")
    assert damaged == 1 and recorded(made.storage) == set(range(8)) - {record.number}
    run(tmp_path / "new")
    assert digests(tmp_path / "new") == digests(finished)


@pytest.mark.parametrize("form", [1, 2])
def test_former_formats_are_refused_in_one_line(tmp_path: Path, finished: Path, form: int) -> None:
    folder = tmp_path / "old"
    shutil.copytree(finished, folder)
    manifest = json.loads((folder / "dataset.json").read_text()) | {"format": form}
    (folder / "dataset.json").write_text(json.dumps(manifest))
    for refused in (lambda: open_dataset(folder), lambda: copy_dataset(folder, tmp_path / "new")):
        with pytest.raises(BadInput, match=f"format {form}, this program reads 3") as caught:
            refused()
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "new").exists()


def test_executors_are_named() -> None:
    assert make_executor("local", workers=None, address=None) == Local(2)
    for wrong in (
        {"name": "lokal", "workers": None, "address": None},
        {"name": "local", "workers": 0, "address": None},
        {"name": "local", "workers": 1, "address": "10.0.0.1"},
    ):
        with pytest.raises(BadInput):
            make_executor(**wrong)
    assert set(PATTERN_ARRAYS) == {"labels", "distance"}
    with pytest.raises(BadInput, match="s3://BUCKET/PREFIX"):
        open_storage("gs://bucket/prefix")
