"""The parts of the generative model: normaliser, network, targets, decoded field, codebook, metric."""

from __future__ import annotations

import numpy as np
import pytest

from deepfracture.carve import voronoi_pattern
from deepfracture.compare import variation_of_information
from deepfracture.learn import Normaliser, PartitionConfig, PartitionModel, normalise_impact
from deepfracture.learn.codes import encode_impulses, nearest_codes
from deepfracture.learn.partition import network
from deepfracture.learn.partition.field import SplineDomain
from deepfracture.learn.partition.selector import ImpulseKernel, MinimumRiskSelector
from deepfracture.learn.partition.targets import FADE, anchors, target_of
from deepfracture.types import BadInput, FracturePattern, Grid, Impact

GRID = Grid(32)


def ball_distance(radius: float = 0.9) -> np.ndarray:
    return (radius - np.linalg.norm(GRID.centres(), axis=-1)).astype(np.float32)


@pytest.fixture(scope="module")
def body() -> SplineDomain:
    return SplineDomain.of(GRID, ball_distance())


@pytest.fixture(scope="module")
def pattern() -> FracturePattern:
    return voronoi_pattern(np.random.default_rng(0).uniform(-0.6, 0.6, (7, 3)), ball_distance() > 0, GRID)


def impact(*strengths: float) -> Impact:
    k = len(strengths)
    position = np.linspace(-1.0, 1.0, 3 * k).reshape(k, 3)
    direction = np.tile([0.6, -0.8, 0.0], (k, 1))
    return Impact(position, direction, strengths, -direction, 3.0, 0.2)


# Normaliser


def test_strengths_fill_minus_one_to_one() -> None:
    assert normalise_impact(impact(50.0), 50.0)[6] == 1
    assert normalise_impact(impact(25.0), 50.0)[6] == 0
    assert normalise_impact(impact(1e-9), 50.0)[6] == pytest.approx(-1)


def test_impulses_beyond_the_largest_known_are_clipped() -> None:
    assert normalise_impact(impact(500.0), 50.0)[6] == 1


def test_position_and_direction_pass_through() -> None:
    row = normalise_impact(impact(5.0), 50.0)
    assert row[:3] == pytest.approx([-1, 0, 1]) and row[3:6] == pytest.approx([0.6, -0.8, 0])


def test_positions_just_outside_the_box_are_clipped() -> None:
    direction = np.array([[1.0, 0, 0]])
    outside = Impact([[1.0 + 1e-4, 0, 0]], direction, [1.0], -direction, 1.0, 0.1)
    assert normalise_impact(outside, 1.0)[0] == 1


def test_a_missing_second_impulse_is_one_of_no_strength() -> None:
    one, two = Normaliser(50.0, 2)(impact(40.0)), Normaliser(50.0, 2)(impact(40.0, 30.0))
    assert one.shape == two.shape == (2, 7)
    assert one[1] == pytest.approx([0, 0, 0, 0, 0, 0, -1])
    assert two[1, 6] == pytest.approx(0.2)


def test_senseless_normalisers_are_refused() -> None:
    for largest in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(BadInput):
            Normaliser(largest)


# Network


def test_impulse_codes_are_those_of_a_sine_layer() -> None:
    config = PartitionConfig(impulse_size=16, features=2)
    weights = network.draw_weights(config, 4, np.random.default_rng(0))
    rows = np.random.default_rng(1).uniform(-1, 1, (3, 2, 7)).astype(np.float32)
    codes = encode_impulses(weights, rows)
    assert codes.shape == (3, 32)
    wanted = np.sin(30 * (rows[2, 1] @ weights["siren.weight"] + weights["siren.bias"]))
    assert codes[2, 16:] == pytest.approx(wanted, abs=1e-5)


def test_numpy_and_torch_decode_alike() -> None:
    torch = pytest.importorskip("torch")
    config = PartitionConfig(hidden=16, basis=24)
    weights = network.draw_weights(config, 5, np.random.default_rng(0))
    tensors = {name: torch.from_numpy(value) for name, value in weights.items()}
    codes = np.random.default_rng(1).normal(size=(3, config.code_size)).astype(np.float32)
    points = np.random.default_rng(2).uniform(-1, 1, (9, 3)).astype(np.float32)
    ours = network.fourier_features(weights, points, np) @ network.mixing_matrices(weights, codes, np)
    theirs = network.fourier_features(tensors, torch.from_numpy(points), torch) @ network.mixing_matrices(
        tensors, torch.from_numpy(codes), torch
    )
    assert ours.shape == (3, 9, 5)
    assert theirs.numpy() == pytest.approx(ours, abs=1e-4)


def test_drawn_weights_have_the_listed_shapes() -> None:
    config = PartitionConfig()
    weights = network.draw_weights(config, 6, np.random.default_rng(0))
    assert {name: value.shape for name, value in weights.items()} == network.shapes(config, 6)


@pytest.mark.parametrize("bad", [{"features": 3}, {"basis": 0}, {"learning_rate": -1.0}])
def test_senseless_configs_are_refused(bad: dict) -> None:
    with pytest.raises(BadInput):
        PartitionConfig(**bad)


def test_the_nearest_code_is_chosen() -> None:
    codes = np.random.default_rng(0).normal(size=(20, 12)).astype(np.float32)
    for index in (0, 7, 19):
        assert nearest_codes(codes, codes[index] + 0.05)[0] == index


# Targets


def test_the_odds_of_a_target_are_the_distance_to_the_crack(pattern: FracturePattern, body: SplineDomain) -> None:
    target = target_of(pattern, body.voxels, anchors(body.points, 8))
    share = target.share.astype(float)
    near = (target.channel != target.next) & (share < 0.95)
    assert near.sum() > 1000
    depth = FADE * np.log(share[near] / (1 - share[near]))
    assert depth == pytest.approx(pattern.distance[body.voxels][near] / GRID.spacing, abs=0.01)


def test_fragments_that_touch_never_share_a_channel(body: SplineDomain) -> None:
    many = voronoi_pattern(np.random.default_rng(3).uniform(-0.8, 0.8, (40, 3)), ball_distance() > 0, GRID)
    target = target_of(many, body.voxels, anchors(body.points, 24))
    assert many.count > 24
    near = target.share < 1
    assert (target.channel != target.next)[near].all()
    for label in np.unique(many.labels[many.labels > 0]):
        assert len(np.unique(target.channel[many.labels[body.voxels] == label])) == 1


def test_voxels_without_a_label_take_a_neighbours(pattern: FracturePattern, body: SplineDomain) -> None:
    bare = pattern.labels.copy()
    bare[16, 16, 16] = 0
    target = target_of(FracturePattern(GRID, bare, pattern.distance), body.voxels, anchors(body.points, 8))
    assert len(target.channel) == len(body.points)


# Variation of information


def test_the_same_division_by_other_names_is_no_distance() -> None:
    a = np.random.default_rng(0).integers(0, 5, 1000)
    assert variation_of_information(a, 7 - a) == pytest.approx(0, abs=1e-9)


def test_variation_of_information_by_hand() -> None:
    assert variation_of_information([1, 1, 2, 2], [1, 1, 1, 1]) == pytest.approx(1)
    assert variation_of_information([1, 1, 2, 2], [1, 2, 1, 2]) == pytest.approx(2)
    assert variation_of_information([1, 1, 2, 2], [3, 3, 3, 9], [True, True, True, False]) == pytest.approx(
        np.log2(3) - 2 / 3
    )


def test_variation_of_information_is_a_metric() -> None:
    rng = np.random.default_rng(1)
    a, b, c = rng.integers(0, 4, (3, 500))
    assert variation_of_information(a, b) == pytest.approx(variation_of_information(b, a))
    assert variation_of_information(a, c) <= variation_of_information(a, b) + variation_of_information(b, c)


def test_labels_of_other_shapes_are_refused() -> None:
    with pytest.raises(BadInput):
        variation_of_information([1, 2], [1, 2, 3])
    with pytest.raises(BadInput):
        variation_of_information([1, 2], [1, 2], [False, False])


def test_a_model_knows_its_shape_by_its_surface_not_by_its_name() -> None:
    from deepfracture.geometry import builtin, signed_distance
    from deepfracture.types import Mesh, Shape

    shape, grid = builtin("bar"), Grid(32)
    body = SplineDomain.of(grid, signed_distance(shape.mesh, grid))
    none = [np.zeros(shape, np.float32) for shape in ((1, 1, 7), (1, 8), (1, 1))]
    nothing = MinimumRiskSelector(*none, ImpulseKernel(0.0, 1.0, 0.3))
    model = PartitionModel("bar", PartitionConfig(), Normaliser(1.0), body, {}, {}, nothing)
    thinner = Shape("bar", Mesh(shape.mesh.vertices * [1, 0.8, 1], shape.mesh.faces))
    assert model.matches_shape(shape)
    assert not model.matches_shape(thinner)
    assert not model.matches_shape(builtin("letter_a"))
