"""Sources on held-out collisions: the floor, the score, and what must not be evaluated at all."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from deepfracture.breakers import PatternSource, make_source, open_patterns
from deepfracture.breakers.cvd import CentroidalVoronoi, fitted_count, spread
from deepfracture.carve import voronoi_pattern
from deepfracture.cli import main
from deepfracture.compare import MEASURES, describe, distances
from deepfracture.compare.partition import contingency_table, normalized_mutual_information
from deepfracture.dataset import (
    Dataset,
    DatasetSettings,
    Sample,
    create_dataset,
    open_dataset,
    write_sample,
    write_unbroken,
)
from deepfracture.evaluate import Evaluation, evaluate, load_evaluation, refuse_overlap, summarise, write_report
from deepfracture.evaluate.collision import Measurement, mean
from deepfracture.evaluate.report import markdown
from deepfracture.evaluate.sensitivity import sensitivities
from deepfracture.evaluate.summary import floors, mott_distance, score_samples
from deepfracture.fracture import material
from deepfracture.geometry import builtin, signed_distance
from deepfracture.learn import normalise_impact
from deepfracture.types import BadInput, FracturePattern, Grid, Impact, Shape

GRID = Grid(32)
BAR = builtin("bar")
PLASTER = material("plaster")
SURFACE = signed_distance(BAR.mesh, GRID)
INSIDE = GRID.to_world(np.argwhere(SURFACE > 0))
BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


def hit(rng: np.random.Generator) -> Impact:
    """Somewhere on the bar, from 1000 to 4000 N s."""
    position = INSIDE[rng.integers(len(INSIDE))]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    return Impact([position], [direction], [rng.uniform(1000, 4000)], [-direction], 9.0, 0.2)


def simulated(impact: Impact, rng: np.random.Generator) -> FracturePattern:
    """Stands in for the simulator: Voronoi cells around the hit, more of them for stronger ones."""
    count = max(2, rng.poisson(impact.magnitude[0] / 400))
    away = np.linalg.norm(INSIDE - impact.position[0], axis=1)
    weight = np.exp(-0.5 * (away / 0.5) ** 2)
    sites = INSIDE[rng.choice(len(INSIDE), count, replace=False, p=weight / weight.sum())]
    return voronoi_pattern(sites + rng.normal(0, 1e-4, sites.shape), SURFACE > 0, GRID)


def make_set(path: Path, *, collisions: int, repeats: int, seed: int, **changes: object) -> Dataset:
    settings = DatasetSettings(BAR, PLASTER, 32, seed, (4.0, 15.0), repeats=repeats)
    create_dataset(path, replace(settings, **changes))  # type: ignore[arg-type]
    for k in range(collisions):
        rng = np.random.default_rng([seed, k])
        impact = hit(rng)
        for repeat in range(repeats):
            write_sample(path, repeats * k + repeat, Sample(impact, simulated(impact, rng), k))
    return open_dataset(path)


def chaos(shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern:
    """Another simulation."""
    return simulated(impact, rng)


def holds(shape: Shape, impact: Impact, rng: np.random.Generator) -> None:
    return None


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_set(tmp_path_factory.mktemp("sets") / "held", collisions=12, repeats=3, seed=1000)


@pytest.fixture(scope="module")
def train(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_set(tmp_path_factory.mktemp("sets") / "train", collisions=15, repeats=1, seed=0)


@pytest.fixture(scope="module")
def sources(train: Dataset) -> dict[str, PatternSource]:
    patterns = open_patterns(BAR, train.path)
    recalled = {name: make_source(name, BAR, PLASTER, GRID, patterns=patterns) for name in ("nearest", "random")}
    return {**recalled, "chaos": chaos, "holds": holds}


@pytest.fixture(scope="module")
def done(held: Dataset, sources: dict[str, PatternSource]) -> Evaluation:
    return evaluate(held, sources, draws=3, seed=5)


def timeless(evaluation: Evaluation) -> list[dict]:
    rows = [
        {name: (answer.volumes, answer.distances, answer.apart) for name, answer in sorted(collision.answers.items())}
        for collision in evaluation.collisions
    ]
    return [*rows, evaluation.sensitivity]


# What is measured


def test_the_floor_is_the_mean_over_pairs_of_repeats(held: Dataset, done: Evaluation) -> None:
    group = held.collisions()[4]
    traits = [describe(held[index].pattern, held[index].impact) for index in group]
    by_hand = mean([distances(a, b) for a, b in combinations(traits, 2)])
    assert done.collisions[4].floor == pytest.approx(by_hand)
    assert done.collisions[4].counts == tuple(one.count for one in traits)
    assert floors(done)["area"] == pytest.approx(np.mean([row.floor["area"] for row in done.collisions]))


def test_what_recalls_one_of_the_repeats_is_as_near_as_they_are(held: Dataset) -> None:
    first = {held[group[0]].impact.speed: 0 for group in held.collisions()}
    assert len(first) == 1  # of one speed, so collisions are told apart by their impulse
    patterns = {held[g[0]].impact.magnitude[0]: [held[i].pattern for i in g] for g in held.collisions()}
    turn = iter(range(10**6))

    def repeats(shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern:
        return patterns[impact.magnitude[0]][next(turn) % 3]

    next(turn), next(turn)  # the call that warms up is the third
    found = evaluate(held, {"repeats": repeats}, draws=3, seed=0)
    summary = summarise(found)["repeats"]
    # Each draw is one of three repeats: at no distance from itself, at the floor from the other two.
    assert summary.score.value == pytest.approx(2 / 3)
    assert all(interval.value == pytest.approx(2 / 3) for interval in summary.measures.values())
    assert summary.diversity.value == pytest.approx(1)
    assert summary.bias.value == pytest.approx(0, abs=1e-9)
    assert summary.volumes == pytest.approx(0)


def test_chaos_itself_scores_one_and_less_knowledge_more(done: Evaluation) -> None:
    found = summarise(done)
    assert found["chaos"].score.value == pytest.approx(1, abs=0.15)
    assert found["chaos"].score.low < 1 < found["chaos"].score.high
    assert found["chaos"].diversity.value == pytest.approx(1, abs=0.2)
    assert found["chaos"].energy.value == pytest.approx(0, abs=0.2)
    assert found["chaos"].score.value < found["random"].score.value < found["holds"].score.value
    assert found["nearest"].diversity.value == 0  # it does not heed the random code
    assert found["nearest"].against_nearest is None
    against = found["chaos"].against_nearest
    assert against is not None
    assert against.value == pytest.approx(found["chaos"].score.value - found["nearest"].score.value)


def test_a_shape_that_held_counts_as_one_fragment(done: Evaluation) -> None:
    answers = [collision.answers["holds"] for collision in done.collisions]
    assert all(answer.counts == (1, 1, 1) for answer in answers)
    summary = summarise(done)["holds"]
    assert summary.bias.value == pytest.approx(1 / np.mean([np.mean(row.counts) for row in done.collisions]) - 1)
    assert summary.rising.value == 0 and summary.sensitivity == 0 and summary.diversity.value == 0


def test_counts_that_rise_with_the_impulse_are_seen(held: Dataset) -> None:
    def slabs(shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern:
        count = int(impact.magnitude[0] / 100)
        sites = np.stack([np.linspace(-0.9, 0.9, count), np.zeros(count), np.zeros(count)], axis=1)
        return voronoi_pattern(sites[:, np.argsort(-np.ptp(INSIDE, axis=0)).argsort()], SURFACE > 0, GRID)

    summary = summarise(evaluate(held, {"slabs": slabs}, draws=1, seed=0))["slabs"]
    assert summary.rising.value > 0.9
    assert math.isnan(summary.diversity.value) and math.isnan(summary.energy.value)
    assert summary.bias.low > 0.5


def test_the_same_seed_gives_the_same_numbers_in_any_order(
    held: Dataset, sources: dict[str, PatternSource], done: Evaluation
) -> None:
    backwards = evaluate(held, dict(reversed(sources.items())), draws=3, seed=5)
    assert timeless(backwards) == timeless(done)
    alone = evaluate(held, {"random": sources["random"]}, draws=3, seed=5)
    assert summarise(alone)["random"].score == summarise(done)["random"].score
    other = evaluate(held, {"random": sources["random"]}, draws=3, seed=6)
    assert summarise(other)["random"].score != summarise(done)["random"].score


def test_sensitivity_tells_who_heeds_the_place_of_the_hit(done: Evaluation) -> None:
    rng = np.random.default_rng(0)
    places = rng.integers(20, 80, 25)

    def parted(at: np.ndarray) -> list[np.ndarray]:
        return [(1 + (np.arange(100) > place)).astype(np.uint16) for place in at]

    repeats = [parted(places + rng.integers(-3, 4, 25)) for _ in range(2)]
    draws = {
        "follows": [parted(places + rng.integers(-3, 4, 25)) for _ in range(2)],
        "ignores": [parted(rng.permutation(places)) for _ in range(2)],
        "same": [parted(np.full(25, 50)) for _ in range(2)],
    }
    measured = [
        Measurement(
            done.collisions[0],
            tuple(repeat[k] for repeat in repeats),
            {name: tuple(draw[k] for draw in of) for name, of in draws.items()},
        )
        for k in range(25)
    ]
    found = sensitivities(measured)
    assert found["simulation"] > 0.8 and found["follows"] > 0.8
    assert abs(found["ignores"]) < 0.3
    assert found["same"] == 0


def test_shared_information_by_hand() -> None:
    def shared(a: list[int], b: list[int]) -> float:
        return normalized_mutual_information(contingency_table(np.array(a), np.array(b), max(a), max(b)))

    assert shared([1, 1, 2, 2], [2, 2, 1, 1]) == pytest.approx(1)
    assert shared([1, 1, 2, 2], [1, 2, 1, 2]) == pytest.approx(0)
    assert shared([1, 1, 1, 1], [1, 1, 1, 1]) == 1
    assert shared([1, 1, 2, 2, 0], [1, 1, 1, 1, 0]) == pytest.approx(0)


def test_motts_own_fragments_are_motts() -> None:
    volumes = -np.log(np.random.default_rng(0).random(20000))
    assert mott_distance([(volumes**3).tolist()]) < 0.02
    assert mott_distance([[1.0] * 10]) == pytest.approx(1 - np.exp(-np.cbrt(6)), abs=1e-9)


# What cannot be evaluated


def test_collisions_without_a_floor_are_left_out(tmp_path: Path) -> None:
    dataset = make_set(tmp_path / "set", collisions=3, repeats=2, seed=1)
    write_unbroken(dataset.path, 6, None, 0)
    write_unbroken(dataset.path, 7, None, 0)
    write_unbroken(dataset.path, 8, None, 0)
    write_sample(dataset.path, 9, dataset[0])
    found = evaluate(open_dataset(dataset.path), {"chaos": chaos}, draws=1, seed=0)
    assert [collision.number for collision in found.collisions] == [0, 1, 2]
    assert found.left_out == 2


def test_a_set_without_repeats_has_no_floor(train: Dataset) -> None:
    with pytest.raises(BadInput, match="--repeats"):
        evaluate(train, {"chaos": chaos}, draws=1, seed=0)


def test_patterns_of_another_resolution_are_refused(held: Dataset) -> None:
    def fine(shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern:
        return FracturePattern(Grid(64), np.ones((64, 64, 64)), np.zeros((64, 64, 64)))

    with pytest.raises(BadInput, match="fine: gives patterns at r = 64"):
        evaluate(held, {"fine": fine}, draws=1, seed=0)


def test_what_was_trained_on_is_not_held_out(held: Dataset, train: Dataset, tmp_path: Path) -> None:
    refuse_overlap(held, train)
    same_seed = make_set(tmp_path / "same", collisions=1, repeats=1, seed=1000)
    with pytest.raises(BadInput, match=r"same seed \(1000\)"):
        refuse_overlap(held, same_seed)
    refuse_overlap(held, make_set(tmp_path / "faster", collisions=0, repeats=1, seed=1000, speed_range=(5.0, 30.0)))
    copied = make_set(tmp_path / "copied", collisions=1, repeats=1, seed=7)
    write_sample(copied.path, 5, held[3])
    with pytest.raises(BadInput, match="holds 3 of the patterns"):
        refuse_overlap(held, open_dataset(copied.path))


def test_other_shapes_and_resolutions_are_refused(held: Dataset, tmp_path: Path) -> None:
    plate = make_set(tmp_path / "plate", collisions=0, repeats=1, seed=0, shape=builtin("plate"))
    with pytest.raises(BadInput, match="another shape"):
        refuse_overlap(held, plate)
    fine = make_set(tmp_path / "fine", collisions=0, repeats=1, seed=0, resolution=64)
    with pytest.raises(BadInput, match="at r = 64"):
        refuse_overlap(held, fine)


# Baselines


def test_nearest_recalls_exactly_the_closest(train: Dataset, held: Dataset, sources: dict[str, PatternSource]) -> None:
    known = np.stack([normalise_impact(impact, train.max_impulse) for impact in train.impacts()])
    for index in (0, 7, 20):
        impact = held[index].impact
        best = np.linalg.norm(known - normalise_impact(impact, train.max_impulse), axis=1).argmin()
        found = sources["nearest"](BAR, impact, np.random.default_rng(0))
        assert found is not None
        assert (found.labels == train[int(best)].pattern.labels).all()
        assert (found.distance == train[int(best)].pattern.distance).all()


def test_random_recalls_every_pattern(sources: dict[str, PatternSource], train: Dataset, held: Dataset) -> None:
    rng = np.random.default_rng(0)
    drawn = [sources["random"](BAR, held[0].impact, rng) for _ in range(100)]
    wanted = {sample.pattern.labels.tobytes() for sample in train}
    assert {pattern.labels.tobytes() for pattern in drawn if pattern} == wanted


def test_centroidal_sites_crowd_around_the_hit() -> None:
    tip = INSIDE[INSIDE[:, np.ptp(INSIDE, axis=0).argmax()].argmax()]
    sites = spread(INSIDE, tip, 12, np.random.default_rng(0))
    away = np.sort(np.linalg.norm(sites - tip, axis=1))
    assert len(sites) == 12
    assert (away < 0.7).sum() >= 5  # a third of the bar's length holds half of the sites
    apart = np.linalg.norm(sites[:, None] - sites, axis=2) + np.eye(12)
    assert apart.min() > 0.05


def test_the_centroidal_count_follows_the_training_data(train: Dataset) -> None:
    source = make_source("cvd", BAR, PLASTER, GRID, patterns=open_patterns(BAR, train.path))
    assert isinstance(source, CentroidalVoronoi)
    counts = [sample.pattern.count for sample in train]
    fitted = [source.count(BAR, impact) for impact in train.impacts()]
    assert np.mean(fitted) == pytest.approx(np.mean(counts))
    weak, strong = (replace(train[0].impact, magnitude=np.array([force])) for force in (1000.0, 4000.0))
    assert 1.5 * source.count(BAR, weak) < source.count(BAR, strong)
    pattern = source(BAR, strong, np.random.default_rng(0))
    assert pattern is not None and abs(pattern.count - source.count(BAR, strong)) < 3
    assert (source(BAR, strong, np.random.default_rng(0)).labels == pattern.labels).all()  # type: ignore[union-attr]


def test_a_power_law_of_counts_is_found() -> None:
    class Known:
        def __init__(self) -> None:
            rng = np.random.default_rng(0)
            self.impacts = [hit(rng) for _ in range(30)]
            self.counts = np.array([2e-4 * impact.magnitude[0] ** 1.4 for impact in self.impacts])

    count = fitted_count(Known())  # type: ignore[arg-type]
    impact = hit(np.random.default_rng(9))
    assert count(BAR, impact) == pytest.approx(2e-4 * impact.magnitude[0] ** 1.4)


# What is written


def test_an_evaluation_comes_back_as_it_was_stored(done: Evaluation, tmp_path: Path) -> None:
    found = write_report(done, tmp_path / "out")
    back = load_evaluation(tmp_path / "out" / "evaluation.json")
    assert back == done
    assert summarise(back) == found
    value = json.loads((tmp_path / "out" / "evaluation.json").read_text(), parse_constant=lambda _: pytest.fail("NaN"))
    assert set(value["floor"]) == set(MEASURES) and set(value["summary"]) == set(done.sources)
    text = (tmp_path / "out" / "evaluation.md").read_text()
    assert text == markdown(done, found)
    assert all(name in text for name in (*MEASURES, *done.sources))
    for name in ("scores", "volumes", "counts"):
        assert (tmp_path / "out" / f"{name}.png").stat().st_size > 5000


def test_other_files_are_no_evaluations(tmp_path: Path) -> None:
    for text in ("{}", "[1]", "no json", '{"format": 99}'):
        (tmp_path / "evaluation.json").write_text(text)
        with pytest.raises(BadInput, match="not an evaluation"):
            load_evaluation(tmp_path / "evaluation.json")


def test_several_shapes_are_merged(done: Evaluation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    from evaluation import evaluation

    write_report(done, tmp_path / "bar")
    other = replace(done, shape="other", collisions=done.collisions[:5])
    write_report(other, tmp_path / "other")
    text = evaluation((tmp_path / "bar", tmp_path / "other"), out=tmp_path / "merged").read_text()
    found = json.loads((tmp_path / "merged" / "scores.json").read_text())
    for name in done.sources:
        scores = [summarise(one)[name].score.value for one in (done, other)]
        assert found[name]["value"] == pytest.approx(np.mean(scores))
        assert found[name]["low"] < found[name]["value"] < found[name]["high"]
        assert name in text
    width = [np.ptp(np.quantile(score_samples(one)["chaos"], (0.025, 0.975))) for one in (done, other)]
    assert found["chaos"]["high"] - found["chaos"]["low"] < max(width)
    with pytest.raises(BadInput, match="one shape"):
        evaluation((tmp_path / "bar", tmp_path / "bar"), out=tmp_path / "merged")


# The command


def test_the_command_writes_everything(held: Dataset, train: Dataset, tmp_path: Path) -> None:
    main([
        "evaluate", str(held.path), "--dataset", str(train.path), "--breakers", "nearest", "cvd", "--draws", "2",
        "--out", str(tmp_path),
    ])  # fmt: skip
    found = load_evaluation(tmp_path / "evaluation.json")
    assert found.sources == ("nearest", "cvd") and found.draws == 2
    assert set(found.collisions[0].answers["cvd"].stages[0]) == {"centroidal voronoi"}  # the shape is known by then
    assert (tmp_path / "scores.png").is_file()


@pytest.mark.parametrize("preset", ["waves", "mlp"])
def test_models_are_measured_without_their_parts(preset: str, held: Dataset, train: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    width = [] if preset == "waves" else ["--width", "0.1"]
    main(["train", str(train.path), "--out", str(tmp_path / "run"), "--preset", preset, "--epochs", "1", *width])
    model = f"mine={tmp_path / 'run' / 'model.safetensors'}"
    main([
        "evaluate", str(held.path), "--dataset", str(train.path), "--model", model, "--ablation", "--draws", "1",
        "--breakers", "nearest", "--out", str(tmp_path / "out"),
    ])  # fmt: skip
    parts = {
        "waves": {"nearest code", "nearest impulse", "no quantisation", "no random code", "no network"},
        "mlp": {"no quantisation", "no segment code"},
    }
    found = load_evaluation(tmp_path / "out" / "evaluation.json").sources
    assert set(found) == {"nearest", "mine", *(f"mine, {part}" for part in parts[preset])}


def test_more_data_and_curves(held: Dataset, train: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(BENCHMARKS)
    from more_data import more_data
    from training_curves import read_curve

    text = more_data(held.path, train.path, counts=(4, 10**6), draws=1, out=tmp_path / "more").read_text()
    assert "| 4 |" in text and f"| {len(train)} |" in text
    with pytest.raises(BadInput, match=r"curve\.csv"):
        read_curve(tmp_path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--dataset", "HELD"], "same seed"),
        (["--breakers", "nearest"], "--dataset"),
        (["--breakers", "magic"], "unknown"),
        (["--breakers", "voronoi", "voronoi"], "given twice"),
        (["--breakers", "voronoi", "--model", "here=nowhere.safetensors"], "nowhere.safetensors"),
        (["--breakers", "voronoi", "--draws", "0"], "draws"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    options: list[str], said: str, held: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [str(held.path) if option == "HELD" else option for option in options]
    with pytest.raises(SystemExit) as stop:
        main(["evaluate", str(held.path), *options, "--out", str(tmp_path / "out")])
    assert stop.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and said in lines[0]
    assert not (tmp_path / "out").exists()
