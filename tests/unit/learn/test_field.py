"""Splines on a coarse lattice, and the GS-SDF that is read from them, at any resolution."""

from __future__ import annotations

import numpy as np
import pytest

from deepfracture.carve import encode, segment, voronoi_pattern
from deepfracture.geometry import builtin, signed_distance
from deepfracture.learn import Inference, Normaliser, PartitionConfig, PartitionModel
from deepfracture.learn.partition import field, network
from deepfracture.learn.partition.field import SplineDomain, decode_logits
from deepfracture.learn.partition.lattice import MOST_NODES, SplineLattice
from deepfracture.learn.partition.selector import ImpulseKernel, MinimumRiskSelector
from deepfracture.types import BadInput, Floats, Grid, Impact
from deepfracture.voxels import cut_faces
from deepfracture.voxels.components import components_of_runs, uncut_runs
from deepfracture.voxels.small_components import relabel_small_components

SITES = np.random.default_rng(0).uniform(-0.6, 0.6, (7, 3))


def ball(resolution: int, radius: float = 0.9) -> SplineDomain:
    grid = Grid(resolution)
    return SplineDomain.of(grid, (radius - np.linalg.norm(grid.centres(), axis=-1)).astype(np.float32))


def near(sites: Floats, points: Floats) -> np.ndarray:
    """Scores whose greatest is that of the nearest site: linear, so that splines hold them exactly."""
    return (20 * (points @ sites.T - 0.5 * (sites**2).sum(axis=1))).astype(np.float32)


def model(body: SplineDomain, seed: int = 0, code_count: int = 4) -> PartitionModel:
    rng = np.random.default_rng(seed)
    config = PartitionConfig(impulse_size=8, hidden=32, wavelength=0.3)
    weights = network.draw_weights(config, 9, rng)
    rows = rng.uniform(-1, 1, (code_count, 1, 7)).astype(np.float32)
    segment = rng.normal(size=(code_count, config.segment_size)).astype(np.float32)
    apart = (1 - np.eye(code_count)).astype(np.float32)
    selector = MinimumRiskSelector(rows, segment, apart, ImpulseKernel(0.0, 1.0, 0.3))
    return PartitionModel("ball", config, Normaliser(1.0), body, {}, weights, selector)


def exact_scores(drawn: PartitionModel, code: np.ndarray) -> np.ndarray:
    """The decoder's channels at every voxel inside, shape (n, channels)."""
    waves = network.fourier_features(drawn.weights, drawn.domain.points.astype(np.float32), np)
    return waves @ network.mixing_matrices(drawn.weights, code[None], np)[0]


# The lattice


@pytest.mark.parametrize("resolution", [32, 64])
def test_linear_functions_are_held_exactly(resolution: int) -> None:
    lattice = ball(resolution).lattice
    slope = np.array([0.3, -1.2, 2.0])
    number = lattice.number
    for voxel in ([resolution // 2] * 3, [resolution // 3, resolution // 2, 2 * resolution // 3]):
        first = lattice.cell[voxel]
        near_by = number[tuple(slice(at, at + 3) for at in first)]
        assert (near_by >= 0).all()
        a, b, c = lattice.weights[voxel]
        found = np.einsum("a,b,c,abc", a, b, c, (lattice.nodes @ slope)[near_by])
        assert found == pytest.approx(Grid(resolution).to_world(voxel) @ slope, abs=1e-5)


def test_gain_makes_splines_the_nearest_to_their_waves() -> None:
    lattice = ball(64).lattice
    vectors = np.random.default_rng(1).normal(size=(3, 40)) * 10
    body = ball(64)
    voxels = np.stack(body.voxels, axis=1)[::97]
    wanted = np.sin(body.grid.to_world(voxels) @ vectors)

    def read(coefficients: np.ndarray) -> np.ndarray:
        found = np.zeros_like(wanted)
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    x, y, z = (lattice.cell[voxels[:, axis]] + step for axis, step in enumerate((a, b, c)))
                    w = [lattice.weights[voxels[:, axis], step] for axis, step in enumerate((a, b, c))]
                    found += (w[0] * w[1] * w[2])[:, None] * coefficients[lattice.number[x, y, z]]
        return ((found - wanted) ** 2).mean()

    waves = np.sin(lattice.nodes @ vectors)
    gain = lattice.gain(vectors)
    best = read(waves * gain)
    assert best < 0.05 * read(waves)
    assert best < read(waves * gain * 1.01) and best < read(waves * gain * 0.99)


@pytest.mark.parametrize("resolution", [32, 64, 128])
def test_nodes_are_few_whatever_the_resolution(resolution: int) -> None:
    grid = Grid(resolution)
    everywhere = SplineLattice.of(grid, np.ones(grid.shape, np.float32))
    assert len(everywhere.nodes) <= MOST_NODES
    assert len(ball(resolution).nodes) <= MOST_NODES


def test_every_voxel_inside_lies_in_a_cell() -> None:
    body = ball(64)
    held = {tuple(cell) for cell in body.lattice.cells}
    assert {tuple(cell) for cell in body.lattice.cell[np.stack(body.voxels, axis=1)]} == held


# The field


@pytest.mark.parametrize("resolution", [32, 64, 128])
def test_two_linear_channels_make_a_plane_with_exact_distances(resolution: int) -> None:
    body = ball(resolution)
    normal = np.array([2.0, -1.0, 2.0]) / 3
    height = body.nodes @ normal - 0.123
    values = decode_logits(body, np.stack([5 * height, -5 * height], axis=1)).values
    inside = body.surface > 0
    wanted = np.minimum(np.abs(body.grid.centres() @ normal - 0.123), body.surface)
    error = np.abs(values - wanted)[inside] / body.grid.spacing
    assert np.quantile(error, 0.999) < 0.1
    assert error.max() < 0.3  # where crack and surface meet an edge to cross the crack may be missing
    assert (values[~inside] == body.surface[~inside]).all()
    assert (values[inside] > 0).all()


@pytest.mark.parametrize("resolution", [32, 64])
def test_scores_of_the_nearest_site_give_its_cells_field(resolution: int) -> None:
    body = ball(resolution)
    pattern = voronoi_pattern(SITES, body.surface > 0, body.grid)
    found = decode_logits(body, near(SITES, body.nodes))
    exact = encode(pattern, body.surface)
    inside = body.surface > 0
    assert np.abs(found.values - exact.values)[inside].mean() < 0.03 * body.grid.spacing
    assert segment(found).count == segment(exact).count


def test_the_crack_crosses_edges_where_the_scores_say() -> None:
    body = ball(32)
    place = float(body.grid.to_world(15.3))
    x = body.nodes[:, 0] - place
    values = decode_logits(body, np.stack([-x, x], axis=1)).values[15:17, 16, 16]
    assert values[0] / values.sum() == pytest.approx(0.3, abs=1e-4)


def test_crumbs_join_their_surroundings() -> None:
    body = ball(64)
    scores = near(SITES, body.nodes)
    clean = decode_logits(body, scores).values
    deepest = body.grid.to_world(np.unravel_index(clean.argmax(), clean.shape))
    away = np.linalg.norm(body.nodes - deepest, axis=1)

    def blob(radius: float) -> np.ndarray:
        extra = (200 * (radius - away)).astype(np.float32)
        return decode_logits(body, np.concatenate([scores, (scores.max(axis=1) + extra)[:, None]], axis=1)).values

    assert (blob(0.03) == clean).all()
    assert not (blob(0.2) == clean).all()


def test_coarse_and_full_evaluation_agree() -> None:
    drawn = model(ball(64))
    r, where = drawn.domain.grid.resolution, drawn.domain.voxels
    for code in drawn.codebook[:2]:
        scores = np.full((r, r, r, 9), np.nan, np.float32)
        scores[where] = exact_scores(drawn, code)
        a, b = scores[:-1], scores[1:]
        first, second = (np.nan_to_num(side, nan=0.0).argmax(axis=-1)[..., None] for side in (a, b))
        crack = ((first != second)[..., 0]) & (np.minimum(drawn.domain.surface[:-1], drawn.domain.surface[1:]) > 0.1)
        ahead, behind = (
            (np.take_along_axis(side, mine, -1)[..., 0] - np.take_along_axis(side, other, -1)[..., 0])[crack]
            for side, mine, other in ((a, first, second), (b, second, first))
        )
        values = drawn.decode(code).values
        here, there = values[:-1][crack], values[1:][crack]
        shift = np.abs(here / (here + there) - ahead / (ahead + behind))
        assert crack.sum() > 1000
        assert np.median(shift) < 0.05


def read_everywhere(body: SplineDomain, scores: np.ndarray) -> np.ndarray:
    """Every spline at every voxel, in float32, shape (r, r, r, channels)."""
    lattice = body.lattice
    near = np.full((*lattice.number.shape, scores.shape[1]), np.nan, np.float32)
    near[lattice.number >= 0] = scores
    for axis in range(3):
        a, b, c = (np.take(near, lattice.cell + step, axis) for step in range(3))
        u, v, w = lattice.weights.T.reshape(3, *(-1 if n == axis else 1 for n in range(4)))
        near = u * a + v * b + w * c
    return near


def plain_labels(body: SplineDomain, scores: np.ndarray) -> np.ndarray:
    """The greatest of all splines at each voxel inside, small components merged, with a border of 0."""
    everywhere = np.nan_to_num(read_everywhere(body, scores), nan=-np.inf)
    labels = np.pad(np.where(body.surface > 0, everywhere.argmax(axis=-1) + 1, 0).astype(np.int16), 1)
    r = body.grid.resolution
    cuts = cut_faces(labels[1:-1, 1:-1, 1:-1])
    runs = uncut_runs(body.runs, cuts)
    smallest = max(2, round(field.SMALL_COMPONENT * r**3))
    relabel_small_components(labels, runs, components_of_runs(runs, cuts), smallest)
    return labels


def plain_distance(body: SplineDomain, scores: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Distance to the cracks [voxels]: of planes beside them, beyond by all four sweeps over all voxels."""
    everywhere = np.nan_to_num(read_everywhere(body, scores))
    inner = tuple(np.moveaxis(np.indices(body.grid.shape), 0, -1)[body.surface > 0].T)
    mine, total = labels[tuple(axis + 1 for axis in inner)], np.zeros(len(inner[0]))
    for axis in range(3):
        nearest = np.full(len(total), 2.0)
        for step in (-1, 1):
            there = tuple(x + step * (n == axis) for n, x in enumerate(inner))
            other = labels[tuple(x + 1 for x in there)]
            meets = (other > 0) & (other != mine)
            here, beyond = ([x[meets] for x in where] for where in (inner, there))
            ahead, behind = (
                np.maximum(everywhere[(*at, a[meets] - 1)] - everywhere[(*at, b[meets] - 1)], 0)
                for at, a, b in ((here, mine, other), (beyond, other, mine))
            )
            both = ahead + behind
            crossing = np.divide(ahead, both, out=np.full_like(both, 0.5), where=both > 0)
            nearest[meets] = np.minimum(nearest[meets], np.maximum(crossing, field.NEAREST))
        total += np.where(nearest < 2, 1 / nearest**2, 0)
    distance = np.full(labels.shape, np.float32(field.FAR))
    distance[tuple(axis + 1 for axis in inner)] = np.where(total > 0, total, field.FAR**-2) ** -0.5
    flat, side = distance.reshape(-1), labels.shape[0]
    inverse = np.float32(1) / np.float32(body.grid.spacing)
    for turn in range(4):
        for i in np.unique(body.runs[:, 0])[:: -1 if turn % 2 else 1]:
            of_plane = body.runs[body.runs[:, 0] == i]
            for _, j, first, end in of_plane[:: 1 if turn in (0, 3) else -1]:
                start = ((i + 1) * side + j + 1) * side + 1
                for k in (*range(first, end), *range(end - 1, first - 1, -1)):
                    field._upwind_update(flat, start + k, side, body.surface[i, j, k] * inverse)
    return distance


@pytest.mark.parametrize("shape", ["ball", "bar", "plate", "two balls"])
def test_shortcuts_change_nothing(shape: str) -> None:
    body = somewhere(shape)
    drawn = model(body, seed=len(shape))
    for code in drawn.codebook[:2]:
        scores = drawn.node_features @ network.mixing_matrices(drawn.weights, code[None], np)[0]
        found, labels = decode_logits(body, scores), plain_labels(body, scores)
        assert found.cuts is not None and len(np.unique(labels)) > 2
        assert (found.cuts == cut_faces(labels[1:-1, 1:-1, 1:-1])).all()
        distance = plain_distance(body, scores, labels)[1:-1, 1:-1, 1:-1]
        wanted = np.where(body.surface > 0, np.minimum(body.surface, distance * body.grid.spacing), body.surface)
        assert np.abs(found.values - wanted).max() < 1e-4 * body.grid.spacing


def somewhere(shape: str) -> SplineDomain:
    """A small body off the middle of a grid."""
    grid = Grid(32)
    place = grid.centres() - 0.2
    if shape == "ball":
        surface = 0.5 - np.linalg.norm(place, axis=-1)
    elif shape == "two balls":
        surface = 0.33 - np.minimum(*(np.linalg.norm(place - side, axis=-1) for side in ([-0.4, 0, 0], [0.3, 0.2, 0])))
    else:
        half = {"bar": [0.7, 0.2, 0.2], "plate": [0.08, 0.5, 0.6]}[shape]
        surface = (np.array(half) - np.abs(place)).min(axis=-1)
    return SplineDomain.of(grid, surface.astype(np.float32))


def test_a_model_divides_alike_at_any_resolution() -> None:
    coarse, fine = model(ball(32)), model(ball(64))
    for code in coarse.codebook[:2]:
        low, high = coarse.decode(code), fine.decode(code)
        inside = coarse.domain.surface > 0.1
        # The centre of a coarse voxel is the corner that eight fine ones share.
        mean = high.values.reshape(32, 2, 32, 2, 32, 2).mean(axis=(1, 3, 5))
        assert np.abs(mean - low.values)[inside].mean() < 0.25 * coarse.domain.grid.spacing


def test_a_models_resolution_can_be_changed() -> None:
    shape = builtin("bar")
    grid = Grid(32)
    own = model(SplineDomain.of(grid, signed_distance(shape.mesh, grid)))
    finer = own.at(shape, 64)
    assert finer.domain.grid.resolution == 64
    assert finer.matches_shape(shape)
    again, first = (each.decode(own.codebook[0]).values for each in (finer.at(shape, 32), own))
    close = own.domain.surface > -0.25
    assert again[close] == pytest.approx(first[close])
    assert own.at(shape, 64) is finer  # the distances are taken once


def test_the_same_code_gives_the_same_bytes() -> None:
    first, second = model(ball(32)), model(ball(32))
    assert first.decode(first.codebook[0]).values.tobytes() == second.decode(second.codebook[0]).values.tobytes()


def test_scores_of_another_body_are_refused() -> None:
    with pytest.raises(BadInput, match="shape"):
        decode_logits(ball(32), np.zeros((5, 3), np.float32))


# The selection of a code


def test_rules_answer_as_they_say() -> None:
    drawn = model(ball(32))
    hit = Impact([drawn.selector.impulses[2, 0, :3]], [[0, 0, 1.0]], [0.5], [[0, 0, -1.0]], speed=1.0, radius=0.2)
    answers = list(drawn.predictions(hit, np.random.default_rng(0), Inference("nearest", random=False)))
    assert len(answers) == 4
    decoded = [drawn.decode(code).values.tobytes() for code in drawn.codebook]
    assert sorted(answer.values.tobytes() for answer in answers) == sorted(decoded)
    rng = np.random.default_rng(0)
    free = list(drawn.predictions(hit, rng, Inference("unquantised")))
    assert len(free) == 1 and free[0].values.tobytes() not in decoded
    with pytest.raises(BadInput, match="selection"):
        Inference("best")
