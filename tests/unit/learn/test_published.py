"""Networks that predict the GS-SDF: their sizes, their training, their files, in one process and in several."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture import learn
from deepfracture.carve import encode, segment, voronoi_pattern
from deepfracture.dataset import Dataset, DatasetSettings, Sample, create_dataset, open_dataset, write_sample
from deepfracture.geometry import signed_distance
from deepfracture.learn import Inference, PublishedConfig, TrainOptions, load_model, model_kind
from deepfracture.learn.checkpoint import read, write
from deepfracture.learn.published.config import preset
from deepfracture.learn.report import TrainingReport
from deepfracture.types import BadInput, Grid, Impact, Material, Mesh, Shape

torch = pytest.importorskip("torch")
torch.set_num_threads(1)  # threads wait for each other longer than such small steps take

from deepfracture.learn import training  # noqa: E402
from deepfracture.learn.distributed import DistributedContext  # noqa: E402
from deepfracture.learn.published import pix2pix  # noqa: E402
from deepfracture.learn.published.data import squared_error  # noqa: E402
from deepfracture.learn.published.model import PublishedModel, build, weight_count  # noqa: E402
from deepfracture.learn.published.train_step import PublishedTrainStep  # noqa: E402

GRID = Grid(32)
CLAY = Material("clay", 40e9, 0.2, 2200.0, 28e6, 0.9e6, 10.0)
DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
TINY = PublishedConfig(width=0.05, impulse_size=16, batch=2, precision="float32")
SLOW = replace(TINY, learning_rate=5e-4)
"""Adam magnifies the rounding of gradients near zero, in proportion to its rate."""
SMALL = {
    "paper": PublishedConfig(width=0.2, batch=2, late_from=0.8, precision="float32"),
    "mlp": PublishedConfig("mlp", width=0.15, batch=2, points=800, learning_rate=2e-3, late_from=0.8),
    "pix2pix": PublishedConfig("pix2pix", width=0.15, learning_rate=1e-3, late_from=0.8, segment_code=False),
}


def train(data: Dataset, out: Path, config: PublishedConfig, **options) -> TrainingReport:
    return learn.train(data, out, TrainOptions(**options), config=config)


def load_published(path: Path, device: str) -> PublishedModel:
    model = load_model(path, device=device)
    assert isinstance(model, PublishedModel)
    return model


def box() -> Shape:
    from trimesh.creation import box as make

    mesh = make(extents=(2.0, 1.4, 1.2))
    return Shape("box", Mesh(mesh.vertices, mesh.faces))


def made(folder: Path, count: int, impulses: int = 1) -> Dataset:
    """Voronoi patterns of few large fragments."""
    shape = box()
    create_dataset(folder, DatasetSettings(shape, CLAY, 32, 0, (1.0, 9.0)))
    surface = signed_distance(shape.mesh, GRID)
    for k in range(count):
        rng = np.random.default_rng(k)
        direction = rng.normal(size=(impulses, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        position = rng.uniform(-0.5, 0.5, (impulses, 3))
        hit = Impact(position, direction, 10.0 + k - np.arange(impulses), -direction, 3.0, 0.2)
        pattern = voronoi_pattern(rng.uniform(-1, 1, (3 + k, 3)) * (0.8, 0.6, 0.5), surface > 0, GRID)
        write_sample(folder, k, Sample(hit, pattern, k))
    return open_dataset(folder)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return made(tmp_path_factory.mktemp("data") / "box", 2)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return made(tmp_path_factory.mktemp("data") / "three", 3)


@pytest.fixture(scope="module")
def run(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "paper"
    train(dataset, folder, SMALL["paper"], epochs=150, device="cpu")
    return folder / "model.safetensors"


def weights(folder: Path) -> dict[str, np.ndarray]:
    arrays = read(folder / "checkpoint.safetensors", PublishedTrainStep.checkpoint_kind)[0]
    return {name: value for name, value in arrays.items() if name != "generator"}


def test_the_full_preset_has_the_size_that_the_paper_reports() -> None:
    at_128, at_256 = weight_count(preset("paper"), 128), weight_count(preset("paper"), 256)
    # 136 numbers to 512 channels of 8^3; 512, 256, 128, 64 channels by kernels of 4^3, biases, two a channel of norms
    expected = 137 * 512 * 8**3 + 64 * (512 * 256 + 256 * 128 + 128 * 64 + 64) + 3 * (256 + 128 + 64)
    assert at_128 == expected
    assert 185 < 4 * at_128 / 1e6 < 190  # MB in float32
    together = weight_count(replace(preset("paper"), resolutions=(32, 64, 128, 256)), 256)
    assert at_128 < at_256 < together < 1.01 * at_128  # "about 1 % on average"
    assert weight_count(preset("paper", features=2), 128) == at_128 + 128 * 512 * 8**3


def test_one_latent_gives_every_resolution() -> None:
    config = replace(TINY, resolutions=(256, 32, 64, 128)).at(256)
    network = build(config, np.zeros(0, np.float32))
    with torch.no_grad():
        fields = network(torch.randn(1, config.code_size))
    assert [tuple(field.shape) for field in fields] == [(1, r, r, r) for r in (32, 64, 128, 256)]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", ["paper", "mlp", "pix2pix"])
def test_training_remembers_simple_patterns(dataset: Dataset, tmp_path: Path, name: str, device: str) -> None:
    epochs = {"paper": 150, "mlp": 200, "pix2pix": 40}[name]
    first = train(dataset, tmp_path / "first", SMALL[name], epochs=1, device=device)
    card = train(dataset, tmp_path / "all", SMALL[name], epochs=epochs, device=device)
    assert card.last.loss < 0.3 * first.last.loss
    model = load_published(card.path, device=device)
    assert model.matches_shape(dataset.shape)
    inside = model.domain.surface > 0
    for index, sample in enumerate(dataset):
        exact = encode(sample.pattern, model.domain.surface, cuts=False)
        decoded = model.predict(sample.impact, np.random.default_rng(0))
        assert np.array_equal(decoded.values[~inside], exact.values[~inside])
        assert (decoded.values[inside] > 0).all()
        if name == "paper":  # the others are worse at it, which is what they are there to show
            assert segment(decoded).count == segment(exact).count == 3 + index


def test_the_same_hit_recalls_the_nearest_code(dataset: Dataset, run: Path) -> None:
    model = load_published(run, device="cpu")
    for index, sample in enumerate(dataset):
        recalled = model.predict(sample.impact, np.random.default_rng(5)).values
        assert np.array_equal(recalled, model.decode(model.codebook[index]).values)


def test_settings_of_inference(dataset: Dataset, run: Path) -> None:
    model, hit = load_published(run, device="cpu"), dataset[0].impact

    def seen(inference: Inference, seed: int) -> np.ndarray:
        return model.predict(hit, np.random.default_rng(seed), inference).values

    free = Inference("unquantised")
    assert not np.array_equal(seen(free, 1), seen(free, 2))
    assert not np.array_equal(seen(free, 1), seen(model.inference, 1))
    without = Inference("unquantised", random=False)
    assert np.array_equal(seen(without, 1), seen(without, 2))
    assert np.array_equal(seen(Inference("nearest", random=False), 1), model.decode(model.codebook[0]).values)
    with pytest.raises(BadInput, match="no distances between its patterns"):
        seen(Inference("minimum risk"), 1)


def test_the_segment_codes_are_learned_unless_they_are_left_out(three: Dataset, tmp_path: Path) -> None:
    train(three, tmp_path / "with", TINY, epochs=1, device="cpu")
    train(three, tmp_path / "without", replace(TINY, segment_code=False), epochs=1, device="cpu")
    drawn = np.random.default_rng(0)
    drawn.uniform(size=8 * TINY.impulse_size)
    before = drawn.standard_normal((3, 8), np.float32)
    assert np.abs(weights(tmp_path / "with")["student.segment"] - before).min() > 0
    assert "student.segment" not in weights(tmp_path / "without")


def test_the_embedding_space_holds_codes_of_this_epoch(three: Dataset, tmp_path: Path) -> None:
    card = train(three, tmp_path, replace(TINY, space=2), epochs=2, device="cpu")
    model = load_published(card.path, device="cpu")
    learned = weights(tmp_path)["student.segment"]
    assert model.codebook.shape == (2, TINY.code_size)
    assert all((np.abs(learned - code[-8:]).max(axis=1) < 1e-6).sum() == 1 for code in model.codebook)


@pytest.mark.parametrize("name", ["paper", "mlp", "pix2pix"])
def test_a_resumed_run_ends_like_an_unbroken_one(
    three: Dataset, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(SMALL[name], width=0.05, points=200)
    train(three, tmp_path / "whole", config, epochs=4, device="cpu")
    epoch = training.Run.train_epoch

    def interrupting(self, budget, interrupted):
        if self.epoch == 1:
            interrupted.set()
        return epoch(self, budget, interrupted)

    with monkeypatch.context() as patch:
        patch.setattr(training.Run, "train_epoch", interrupting)
        with pytest.raises(KeyboardInterrupt):
            train(three, tmp_path / "broken", config, epochs=4, device="cpu")
    assert not (tmp_path / "broken" / "model.safetensors").exists()
    train(three, tmp_path / "broken", config, epochs=4, device="cpu")
    whole, broken = weights(tmp_path / "whole"), weights(tmp_path / "broken")
    assert whole.keys() == broken.keys()
    for key, value in whole.items():
        assert np.array_equal(value, broken[key]), key


@pytest.mark.slow
def test_two_processes_learn_what_one_learns(three: Dataset, tmp_path: Path) -> None:
    """Three patterns in steps of two: in the last step of an epoch one process has nothing to do."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    script = (
        "import torch; torch.set_num_threads(1)\n"
        "from deepfracture.dataset import open_dataset\n"
        "from deepfracture.learn import PublishedConfig, TrainOptions, train\n"
        f"data, options = open_dataset({str(three.path)!r}), TrainOptions(epochs=2, device='cpu')\n"
        f"train(data, {str(tmp_path / 'two')!r}, options, config={SLOW!r})\n"
    )
    shared = {**os.environ, "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": "2"}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", script],
            env={**shared, "RANK": str(rank), "LOCAL_RANK": str(rank)},
            stderr=subprocess.PIPE,
        )
        for rank in range(2)
    ]
    train(three, tmp_path / "one", SLOW, epochs=2, device="cpu")
    for process in processes:
        error = process.communicate(timeout=120)[1]
        assert process.returncode == 0, error.decode()
    one, two = weights(tmp_path / "one"), weights(tmp_path / "two")
    assert one.keys() == two.keys()
    for key, value in one.items():
        if not key.startswith("adam."):
            assert np.abs(value - two[key]).max() < 1e-5, key


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", ["paper", "mlp", "pix2pix"])
def test_two_impulses(tmp_path: Path, name: str, device: str) -> None:
    data = made(tmp_path / "data", 2, impulses=2)
    config = replace(SMALL[name], width=0.05, features=2, points=200)
    card = train(data, tmp_path / "run", config, epochs=1, device=device)
    model = load_published(card.path, device=device)
    assert model.codebook.shape[1] == 2 * (7 if name == "pix2pix" else 128) + 8
    two, rng = data[0].impact, np.random.default_rng
    one = Impact(*(rows[:1] for rows in (two.position, two.direction, two.magnitude, two.normal)), 3.0, 0.2)
    free = Inference("unquantised")
    assert not np.array_equal(model.predict(two, rng(0), free).values, model.predict(one, rng(0), free).values)


def test_minutes_end_within_a_pass(three: Dataset, tmp_path: Path) -> None:
    card = train(three, tmp_path, replace(TINY, batch=1), minutes=1e-6, device="cpu")
    assert card.last.epoch == 1
    assert weights(tmp_path)["adam.student.network.first.weight.step"] == 1  # of three patterns


@pytest.mark.parametrize("device", DEVICES)
def test_bfloat16_trains_too(three: Dataset, tmp_path: Path, device: str) -> None:
    config = replace(TINY, precision="bfloat16")
    first = train(three, tmp_path / "first", config, epochs=1, device=device)
    card = train(three, tmp_path / "all", config, epochs=20, device=device)
    assert card.last.loss < 0.8 * first.last.loss
    assert weights(tmp_path / "all")["student.network.first.weight"].dtype == np.float32


def test_resolutions_are_learned_together(tmp_path: Path) -> None:
    shape, grid = box(), Grid(64)
    surface = signed_distance(shape.mesh, grid)
    create_dataset(tmp_path / "data", DatasetSettings(shape, CLAY, 64, 0, (1.0, 9.0)))
    pattern = voronoi_pattern(np.array([[-0.5, 0, 0], [0.5, 0, 0]]), surface > 0, grid)
    push = np.array([[1.0, 0, 0]])
    hit = Impact(np.array([[-1.0, 0, 0]]), push, [10.0], -push, 3.0, 0.2)
    write_sample(tmp_path / "data", 0, Sample(hit, pattern, 0))
    config = replace(TINY, resolutions=(32, 64), width=0.1)
    card = train(open_dataset(tmp_path / "data"), tmp_path / "run", config, epochs=60, device="cpu")
    model = load_published(card.path, device="cpu")
    fine, coarse = model.decode(model.codebook[0]), model.decode(model.codebook[0], 32)
    for field in fine, coarse:  # a crack at x = 0, between fragments that are deepest at x = 0.5
        along = field.values.max(axis=(1, 2))
        assert along[len(along) // 2] < 0.6 * along[3 * len(along) // 4]
    halved = fine.values.reshape(32, 2, 32, 2, 32, 2).mean(axis=(1, 3, 5))
    inside = coarse.values > 0
    assert np.abs(halved - coarse.values)[inside].mean() < 0.1 * coarse.values.max()
    with pytest.raises(BadInput, match="resolution must be one of those learned"):
        model.decode(model.codebook[0], 128)


def test_ridges_weigh_more_if_asked() -> None:
    surface = torch.full((32, 32, 32), 0.5)
    truth = surface.clone()[None]
    truth[:, 16] = 0.02  # a crack
    beside, on = truth.clone(), truth.clone()
    beside[:, 4] += 0.1
    on[:, 16] += 0.1
    assert torch.isclose(squared_error(on, truth, surface, 0.0), squared_error(beside, truth, surface, 0.0)).all()
    assert squared_error(on, truth, surface, 7.0) > 5 * squared_error(beside, truth, surface, 7.0)


def test_blocks_are_spread_over_their_voxels() -> None:
    field = torch.randn(2, 8, 8, 8)
    assert torch.equal(pix2pix.depth_to_space(pix2pix.space_to_depth(field)), field)
    assert torch.equal(pix2pix.space_to_depth(field)[:, 0], field[:, ::2, ::2, ::2])


def test_noise_changes_what_pix2pix_says() -> None:
    torch.manual_seed(0)
    config = SMALL["pix2pix"].at(32)
    network = build(config, np.full((32, 32, 32), 0.1, np.float32))
    codes = torch.randn(2, config.code_size)
    codes[1, :7] = codes[0, :7]
    with torch.no_grad():
        first, second = network(codes)
    assert (first - second).abs().max() > 1e-4


def test_files_tell_their_kind(run: Path) -> None:
    assert model_kind(run) == "field model"
    assert model_kind(run.with_name("checkpoint.safetensors")) == "field training checkpoint"
    with pytest.raises(BadInput, match="no such file"):
        model_kind(run.with_name("other.safetensors"))


def test_loading_refuses_damage(run: Path, tmp_path: Path) -> None:
    arrays, facts = read(run, "field model")
    facts.pop("kind")
    bad = tmp_path / "bad.safetensors"

    def refused(arrays: dict, facts: dict, about: str) -> None:
        write(bad, "field model", arrays, facts)
        with pytest.raises(BadInput, match=about) as error:
            load_published(bad, device="cpu")
        assert "\n" not in str(error.value)

    refused({**arrays, "network.first.bias": arrays["network.first.bias"][1:]}, facts, "network.first.bias")
    refused({**arrays, "codebook": np.full_like(arrays["codebook"], np.nan)}, facts, "codebook")
    refused({k: v for k, v in arrays.items() if k != "siren.bias"}, facts, "siren.bias")
    refused({**arrays, "surface": arrays["surface"][:20]}, facts, "damaged")
    refused(arrays, {**facts, "format": 99}, "format 99")
    refused(arrays, {**facts, "config": {**facts["config"], "width": 0}}, "width")
    refused(arrays, {**facts, "config": {**facts["config"], "width": 1e9}}, "width")
    refused(arrays, {**facts, "resolution": 64}, "damaged")
    bad.write_bytes(run.read_bytes()[:-100])
    with pytest.raises(BadInput, match="damaged"):
        load_published(bad, device="cpu")


def test_another_run_is_not_resumed(dataset: Dataset, run: Path) -> None:
    with pytest.raises(BadInput, match="other config"):
        train(dataset, run.parent, TINY, epochs=2, device="cpu")
    with pytest.raises(BadInput, match="other seed"):
        train(dataset, run.parent, SMALL["paper"], epochs=2, device="cpu", seed=1)


def test_another_shape_does_not_fit(run: Path) -> None:
    from trimesh.creation import icosphere

    ball = icosphere()
    assert not load_published(run, device="cpu").matches_shape(Shape("ball", Mesh(ball.vertices, ball.faces)))


def test_bad_settings_are_named(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="preset must be one of"):
        preset("gan")
    with pytest.raises(BadInput, match="width"):
        preset("paper", width=-1)
    with pytest.raises(BadInput, match="resolutions"):
        train(dataset, tmp_path, replace(TINY, resolutions=(32, 64)), epochs=1, device="cpu")
    with pytest.raises(BadInput, match="one resolution"):
        replace(SMALL["mlp"], resolutions=(32, 64)).at(64)
    with pytest.raises(BadInput, match="not usable here"):
        train(dataset, tmp_path, TINY, epochs=1, device="warp")
    with pytest.raises(BadInput, match="epochs or minutes"):
        train(dataset, tmp_path, TINY, device="cpu")


def test_the_command_line_trains_every_preset(dataset: Dataset, tmp_path: Path) -> None:
    from deepfracture.cli.learning import train

    options = TrainOptions(preset="paper", width=0.05, features=2, epochs=1, device="cpu", seed=3)
    train(dataset.path, out=tmp_path / "run", options=options)
    model = load_published(tmp_path / "run" / "model.safetensors", device="cpu")
    assert (model.config.width, model.config.features, model.metadata["seed"]) == (0.05, 2, 3)
    with pytest.raises(BadInput, match="preset must be one of waves, paper, mlp, pix2pix"):
        train(dataset.path, out=tmp_path, options=TrainOptions(preset="gan", epochs=1, device="cpu"))
    with pytest.raises(BadInput, match="only for the presets"):
        train(dataset.path, out=tmp_path, options=TrainOptions(preset="waves", width=0.5, epochs=1, device="cpu"))


def test_processes_share_every_sample_once() -> None:
    chosen = torch.arange(5)
    total = torch.zeros(5)
    for rank in range(3):
        mine, share = DistributedContext(torch.device("cpu"), rank, 3).shard(chosen)
        total.index_add_(0, mine, share / 3)  # the mean over processes
    assert torch.allclose(total, torch.full((5,), 0.2))


def test_the_card_tells_the_run(run: Path) -> None:
    card = (run.parent / "card.txt").read_text()
    assert "--preset paper --width 0.2" in card
    assert (run.parent / "curve.png").stat().st_size > 1000
    lines = (run.parent / "curve.csv").read_text().splitlines()
    assert len(lines) > 2
    assert lines[0].startswith("epoch,seconds,loss")


def test_importing_needs_no_torch() -> None:
    code = "import sys, deepfracture.learn.published.config as f; f.preset('paper'); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
