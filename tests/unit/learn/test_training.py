"""Training on a small real case: it remembers, resumes exactly, and its files are safe to read."""

from __future__ import annotations

import csv
import json
import pickle
import signal
import threading
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture import learn
from deepfracture.carve import encode, segment, voronoi_pattern
from deepfracture.compare import variation_of_information
from deepfracture.dataset import (
    Dataset,
    DatasetSettings,
    Sample,
    create_dataset,
    open_dataset,
    write_sample,
    write_unbroken,
)
from deepfracture.dataset.entries import read_sample
from deepfracture.geometry import signed_distance
from deepfracture.learn import (
    Inference,
    PartitionConfig,
    TrainOptions,
    embedded_model,
    load_model,
    load_partition_model,
)
from deepfracture.learn.checkpoint import pack_distance, read, unpack_distance, write
from deepfracture.learn.partition import network
from deepfracture.learn.report import TrainingReport
from deepfracture.types import BadInput, Grid, Impact, Material, Mesh, Shape

torch = pytest.importorskip("torch")
torch.set_num_threads(1)  # threads wait for each other longer than such small steps take

GRID = Grid(32)
SMALL = PartitionConfig(
    impulse_size=32, hidden=32, basis=160, wavelength=0.25, batch=4, points=1500, learning_rate=1e-2
)
CLAY = Material("clay", 40e9, 0.2, 2200.0, 28e6, 0.9e6, 10.0)


def train(data: Dataset, out: Path, config: PartitionConfig, **options) -> TrainingReport:
    return learn.train(data, out, TrainOptions(**options), config=config)


def box() -> Shape:
    from trimesh.creation import box as make

    mesh = make(extents=(2.0, 1.4, 1.2))
    return Shape("box", Mesh(mesh.vertices, mesh.faces))


def made(folder: Path, count: int = 4) -> Dataset:
    """A data set of Voronoi patterns."""
    shape = box()
    create_dataset(folder, DatasetSettings(shape, CLAY, 32, 0, (1.0, 9.0)))
    surface = signed_distance(shape.mesh, GRID)
    for k in range(count):
        rng = np.random.default_rng(k)
        direction = rng.normal(size=(1, 3))
        direction /= np.linalg.norm(direction)
        hit = Impact(rng.uniform(-0.5, 0.5, (1, 3)), direction, [10.0 + k], -direction, 3.0, 0.2)
        pattern = voronoi_pattern(rng.uniform(-1, 1, (3 + 2 * k, 3)) * (0.8, 0.6, 0.5), surface > 0, GRID)
        write_sample(folder, k, Sample(hit, pattern, k))
    write_unbroken(folder, count, None, 0)
    return open_dataset(folder)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return made(tmp_path_factory.mktemp("data") / "box")


@pytest.fixture(scope="module")
def run(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "model"
    train(dataset, folder, SMALL, epochs=250, device="cpu")
    return folder


def test_training_patterns_are_remembered(dataset: Dataset, run: Path) -> None:
    model = load_model(run / "model.safetensors")
    for index, sample in enumerate(dataset):
        exact = segment(encode(sample.pattern, model.domain.surface))
        found = segment(model.decode(model.codebook[index]))
        assert found.count == exact.count > 2
        assert variation_of_information(found.labels, exact.labels, exact.labels > 0) < 0.5


def test_the_hit_of_a_training_pattern_recalls_it(dataset: Dataset, run: Path) -> None:
    model = load_model(run / "model.safetensors")
    index = 2
    volume = model.predict(dataset[index].impact, np.random.default_rng(0), Inference("nearest"))
    nearest = [int((volume.values == model.decode(code).values).all()) for code in model.codebook]
    assert nearest == [0, 0, 1, 0]


def test_one_seed_one_prediction(dataset: Dataset, run: Path) -> None:
    model = load_model(run / "model.safetensors")
    once, again = (model.predict(dataset[0].impact, np.random.default_rng(5)).values for _ in range(2))
    assert (once == again).all()


def test_a_run_leaves_curve_and_card(run: Path) -> None:
    with (run / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) >= 4
    assert float(rows[-1]["loss"]) < 0.8 * float(rows[0]["loss"])
    assert (run / "curve.png").read_bytes().startswith(b"\x89PNG")
    card = (run / "card.txt").read_text()
    assert "deepfracture simulate box --collisions 5" in card and "seed 0" in card and "true" in card
    assert str(run.parent) not in card


def test_the_sine_layer_and_the_waves_stay_as_drawn(run: Path) -> None:
    model = load_partition_model(run / "model.safetensors")
    drawn = network.draw_weights(SMALL, model.channels, np.random.default_rng(0))
    weights = model.weights
    for name in network.FROZEN:
        assert (weights[name] == drawn[name]).all()
    assert (weights["head.bias"] != drawn["head.bias"]).any()


def test_a_resumed_run_ends_like_an_unbroken_one(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from deepfracture.learn import training

    train(dataset, tmp_path / "whole", SMALL, epochs=12, device="cpu", seed=1)
    epoch = training.Run.train_epoch

    def interrupting(self: training.Run, budget: training.Budget, interrupted: threading.Event) -> bool:
        if self.epoch == 4:
            signal.raise_signal(signal.SIGINT)
        return epoch(self, budget, interrupted)

    with monkeypatch.context() as patch:
        patch.setattr(training.Run, "train_epoch", interrupting)
        with pytest.raises(KeyboardInterrupt):
            train(dataset, tmp_path / "halves", SMALL, epochs=12, device="cpu", seed=1)
    assert not (tmp_path / "halves" / "model.safetensors").exists()
    train(dataset, tmp_path / "halves", SMALL, epochs=12, device="cpu", seed=1)
    whole, halves = (load_partition_model(tmp_path / name / "model.safetensors") for name in ("whole", "halves"))
    for name, value in whole.weights.items():
        assert (halves.weights[name] == value).all(), name
    assert (whole.codebook == halves.codebook).all()
    columns = [[line.split(",")[2] for line in (tmp_path / n / "curve.csv").open()] for n in ("whole", "halves")]
    assert columns[0] == columns[1]


def test_training_works_off_the_main_thread(dataset: Dataset, tmp_path: Path) -> None:
    thread = threading.Thread(target=train, args=(dataset, tmp_path / "run", SMALL), kwargs={"epochs": 1})
    thread.start()
    thread.join()
    assert (tmp_path / "run" / "model.safetensors").is_file()


def test_minutes_are_kept(dataset: Dataset, tmp_path: Path) -> None:
    card = train(dataset, tmp_path / "run", SMALL, minutes=0.02, device="cpu")
    assert card.last.seconds >= 1.2 and card.last.epoch >= 1


@pytest.mark.parametrize("budget", [{}, {"epochs": 2, "minutes": 1.0}, {"epochs": 0}, {"minutes": -1.0}])
def test_senseless_budgets_are_refused(dataset: Dataset, tmp_path: Path, budget: dict) -> None:
    with pytest.raises(BadInput, match="epochs"):
        train(dataset, tmp_path / "run", SMALL, **budget)


def test_an_unknown_device_is_one_line(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="device 'warp'") as caught:
        train(dataset, tmp_path / "run", SMALL, epochs=1, device="warp")
    assert "\n" not in str(caught.value)


def test_a_checkpoint_of_another_run_is_refused(dataset: Dataset, run: Path) -> None:
    with pytest.raises(BadInput, match="other seed"):
        train(dataset, run, SMALL, epochs=300, seed=9)


def test_an_empty_data_set_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no collision broke"):
        train(made(tmp_path / "box", 0), tmp_path / "run", SMALL, epochs=1)


def test_two_impulses_can_be_encoded(dataset: Dataset, tmp_path: Path) -> None:
    from dataclasses import replace

    card = train(dataset, tmp_path / "run", replace(SMALL, features=2), epochs=1, device="cpu")
    model = load_model(card.path)
    assert model.codebook.shape == (4, 2 * 32 + 8)
    model.predict(dataset[0].impact, np.random.default_rng(0))


# Files


class Evil:
    def __reduce__(self):
        return (print, ("executed",))


def test_a_pickle_is_refused_unread(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.safetensors"
    path.write_bytes(pickle.dumps(Evil()))
    with pytest.raises(BadInput, match="not a model") as caught:
        load_model(path)
    assert "\n" not in str(caught.value) and "executed" not in capsys.readouterr().out


def test_a_missing_model_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no such file"):
        load_model(tmp_path / "nothing.safetensors")


@pytest.mark.parametrize("size", [0, 7, 500, -1000])
def test_a_truncated_model_is_refused(run: Path, tmp_path: Path, size: int) -> None:
    path = tmp_path / "model.safetensors"
    path.write_bytes((run / "model.safetensors").read_bytes()[:size])
    with pytest.raises(BadInput) as caught:
        load_model(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda arrays, facts: arrays.pop("head.weight"), "head.weight"),
        (lambda arrays, facts: arrays.update({"first.bias": np.zeros(3, np.float32)}), "first.bias"),
        (lambda arrays, facts: arrays["segment"].__setitem__((0, 0), np.nan), "segment"),
        (lambda arrays, facts: arrays.update({"rows": np.zeros((0, 1, 7), np.float32)}), "rows"),
        (lambda arrays, facts: arrays.update({"apart": np.zeros((2, 2), np.float32)}), "apart"),
        (lambda arrays, facts: facts["similarity"].update({"warmth": 1}), "warmth"),
        (lambda arrays, facts: arrays.update({"head.bias": np.zeros(1, np.int64)}), "head.bias"),
        (lambda arrays, facts: arrays.update({"surface": np.zeros(9, np.uint8)}), "damaged"),
        (lambda arrays, facts: facts.update({"resolution": 31}), "resolution"),
        (lambda arrays, facts: facts["config"].update({"layers": 3}), "layers"),
        (lambda arrays, facts: facts.update({"channels": 10**9}), "head.weight"),
        (lambda arrays, facts: facts.update({"format": 99}), "format 99"),
        (lambda arrays, facts: facts.update({"max_impulse": None}), "damaged"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(run: Path, tmp_path: Path, change, words: str) -> None:
    arrays, facts = read(run / "model.safetensors", "model")
    arrays = {name: value.copy() for name, value in arrays.items()}
    change(arrays, facts)
    facts.pop("kind")
    path = tmp_path / "model.safetensors"
    write(path, "model", arrays, json.loads(json.dumps(facts)))
    with pytest.raises(BadInput, match=words) as caught:
        load_model(path)
    assert "\n" not in str(caught.value)


def test_a_checkpoint_is_not_taken_for_a_model(run: Path) -> None:
    with pytest.raises(BadInput, match="a training checkpoint, not a model"):
        load_model(run / "checkpoint.safetensors")


def test_distances_are_stored_to_a_fraction_of_a_voxel() -> None:
    distance = np.random.default_rng(0).normal(size=GRID.shape).astype(np.float32)
    back = unpack_distance(pack_distance(distance, GRID), GRID)
    assert np.abs(back - distance).max() <= GRID.spacing / 512 + 1e-6


def test_shapes_without_a_shipped_model_have_none() -> None:
    assert embedded_model("no such shape") is None


def test_samples_are_read_once_and_not_kept(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of thirty patterns a few are alive at a time: those that are watched, and the one that has just been read."""
    many = replace(dataset, records=tuple(replace(dataset.samples[i % len(dataset)], number=i) for i in range(30)))
    reads: list[str] = []
    alive: set[int] = set()
    most = 0
    read = read_sample

    def counted(storage, record, resolution):
        nonlocal most
        reads.append(record.name)
        sample = read(storage, replace(record, number=record.number % len(dataset)), resolution)
        alive.add(id(sample.pattern))
        weakref.finalize(sample.pattern, alive.discard, id(sample.pattern))
        most = max(most, len(alive))
        return sample

    monkeypatch.setattr("deepfracture.dataset.dataset.read_sample", counted)
    train(many, tmp_path / "run", SMALL, epochs=1, device="cpu")
    assert reads == [f"{k:06d}" for k in range(30)]
    assert most <= 10 + 2
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "checkpoint.safetensors", "model.safetensors", "card.txt", "curve.csv", "curve.png"
    }  # fmt: skip


def test_several_processes_are_refused(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(BadInput, match="preset waves trains in one process"):
        train(dataset, tmp_path / "run", SMALL, epochs=1, device="cpu")
