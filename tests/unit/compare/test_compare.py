"""What describes a pattern, against closed forms; how far two are apart, against laws and hand-made cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepfracture.carve import voronoi_pattern
from deepfracture.compare import MEASURES, Descriptors, describe, distances
from deepfracture.compare.cracks import BINS, axes, crack_surface
from deepfracture.types import BadInput, FracturePattern, Grid, Impact

GRID = Grid(64)
SMALL = Grid(32)
HIT = Impact([[0.5, 0, 0]], [[-1, 0, 0]], [10.0], [[1, 0, 0]], 5.0, 0.2)
UNIT = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


def pattern_of(labels: np.ndarray, grid: Grid = GRID) -> FracturePattern:
    return FracturePattern(grid, labels, np.zeros(grid.shape))


def slabs(cuts: tuple[float, ...], grid: Grid = GRID) -> FracturePattern:
    """The box |x| < 0.5, |y| < 0.25, |z| < 0.25, cut across x."""
    x, y, z = np.moveaxis(grid.centres(), -1, 0)
    inside = (abs(x) < 0.5) & (abs(y) < 0.25) & (abs(z) < 0.25)
    return pattern_of(np.where(inside, 1 + np.searchsorted(cuts, x), 0), grid)


def cells(seed: int, count: int) -> FracturePattern:
    rng = np.random.default_rng(seed)
    ball = 0.8 - np.linalg.norm(SMALL.centres(), axis=-1)
    return voronoi_pattern(rng.uniform(-0.7, 0.7, (count, 3)), ball > 0, SMALL)


def relabelled(pattern: FracturePattern, seed: int = 0) -> FracturePattern:
    """The same division under other names, with gaps between them."""
    names = 3 * np.random.default_rng(seed).permutation(int(pattern.labels.max())) + 5
    return pattern_of(np.concatenate([[0], names])[pattern.labels], pattern.grid)


def same(a: Descriptors, b: Descriptors) -> bool:
    return all(value == pytest.approx(0, abs=1e-6) for value in distances(a, b).values())


def main_axis(shares: np.ndarray) -> np.ndarray:
    """Where most of the crack area faces."""
    return np.linalg.eigh((axes().T * shares) @ axes())[1][:, -1]


# Descriptors


def test_slabs_have_the_traits_of_slabs() -> None:
    traits = describe(slabs((-0.25, 0.0)), HIT)
    assert traits.count == 3
    assert traits.volumes == pytest.approx([0.0625, 0.0625, 0.125])
    assert traits.area == pytest.approx(2 * 0.25, rel=1e-6)
    # Centres at x = -0.375, -0.125 and 0.25: their mean is -1/12, seen from the hit at 0.5.
    assert traits.centre == pytest.approx([-0.25 / 3 - 0.5, 0, 0])
    assert traits.size == pytest.approx(np.std([-0.375, -0.125, 0.25]))


@pytest.mark.parametrize("normal", [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 2, 5), (-3, 1, 0.3)])
def test_a_tilted_plane_has_its_area_and_normal(normal: tuple[float, ...]) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    centres = GRID.centres()
    labels = np.where(np.linalg.norm(centres, axis=-1) < 0.9, 1 + (centres @ n > 0.1), 0)
    area, shares = crack_surface(labels.astype(np.int32), GRID.spacing)
    assert area == pytest.approx(np.pi * (0.9**2 - 0.1**2), rel=0.04)
    assert abs(main_axis(shares) @ n) > np.cos(0.1)
    assert shares[np.abs(axes() @ n) < np.cos(1.0)].sum() < 0.02


def test_a_sphere_has_its_area_and_faces_everywhere() -> None:
    away = np.linalg.norm(GRID.centres(), axis=-1)
    area, shares = crack_surface(np.where(away < 0.95, 1 + (away < 0.6), 0).astype(np.int32), GRID.spacing)
    assert area == pytest.approx(4 * np.pi * 0.6**2, rel=0.02)
    assert 0.5 * np.abs(shares - 1 / BINS).sum() < 0.1


def test_a_thin_wall_does_not_turn_the_normal() -> None:
    x, y, z = np.moveaxis(GRID.centres(), -1, 0)
    n = np.array([np.cos(0.6), 0, np.sin(0.6)])
    labels = np.where((abs(z) < 2.5 * GRID.spacing) & (abs(y) < 0.9), 1 + (x * n[0] + z * n[2] > 0), 0)
    area, shares = crack_surface(labels.astype(np.int32), GRID.spacing)
    assert area == pytest.approx(4 * GRID.spacing / n[0] * 1.8, rel=0.1)  # four layers of voxels lie within
    assert abs(main_axis(shares) @ n) > np.cos(0.15)


def test_a_whole_body_has_no_crack() -> None:
    traits = describe(slabs(()), HIT)
    assert (traits.count, traits.area, traits.size) == (1, 0, 0)
    assert not traits.normals.any()


def test_other_names_for_the_fragments_change_nothing() -> None:
    pattern = cells(3, 9)
    assert same(describe(pattern, HIT), describe(relabelled(pattern), HIT))


def test_points_lie_on_the_fragments_surfaces() -> None:
    traits = describe(slabs((0.0,)), HIT)
    left, right = np.split(traits.points, traits.starts[1:-1])
    assert (left[:, 0] < 0).all() and (right[:, 0] > 0).all()
    depth = np.minimum(np.minimum(0.5 - abs(right[:, 0]), right[:, 0]), 0.25 - np.abs(right[:, 1:]).max(axis=1))
    assert depth.max() < GRID.spacing
    assert len(np.unique(traits.points, axis=0)) == len(traits.points)


def test_nothing_cannot_be_described() -> None:
    with pytest.raises(BadInput, match="no fragment"):
        describe(pattern_of(np.zeros(GRID.shape)), HIT)


# Distances


def test_distances_by_hand() -> None:
    two, three = describe(slabs((0.0,)), HIT), describe(slabs((0.0, 0.25)), HIT)
    found = distances(two, three)
    assert tuple(found) == MEASURES
    assert found["count"] == pytest.approx(1 / 2.5)
    assert found["volumes"] == pytest.approx(2 / 3)  # two of three are smaller than all of the others
    assert found["area"] == pytest.approx(1 / 1.5)
    assert found["normals"] == pytest.approx(0, abs=1e-9)
    assert found["centre"] == pytest.approx(0.25 / 3)  # the mean of -0.25, 0.125 and 0.375, against 0
    assert found["size"] == pytest.approx(2 * (np.std([-2, 1, 3]) - 2) / (np.std([-2, 1, 3]) + 2), rel=1e-6)
    assert found["division"] == pytest.approx(0.5)  # one bit, for half of the body


def test_perpendicular_cracks_are_as_unlike_as_can_be() -> None:
    x, y, z = np.moveaxis(SMALL.centres(), -1, 0)
    inside = (abs(x) < 0.5) & (abs(y) < 0.5) & (abs(z) < 0.5)
    across, along = (describe(pattern_of(np.where(inside, 1 + (side > 0), 0), SMALL), HIT) for side in (x, y))
    found = distances(across, along)
    assert found["normals"] > 0.99
    assert found["division"] == pytest.approx(2)
    for equal in ("count", "volumes", "area", "size"):
        assert found[equal] == pytest.approx(0, abs=1e-9)


def test_the_chamfer_distance_follows_a_moving_crack() -> None:
    still = describe(slabs((0.0,)), HIT)
    moved = [distances(still, describe(slabs((x,)), HIT))["chamfer"] for x in (0.0, 0.0625, 0.125, 0.25)]
    assert moved[0] == 0
    assert (np.diff(moved) > 0).all()
    assert moved[-1] < 0.25


def test_a_whole_body_is_as_far_as_can_be_from_cracks() -> None:
    whole, broken = describe(slabs(()), HIT), describe(slabs((-0.25, 0.0, 0.25)), HIT)
    found = distances(whole, broken)
    assert found["normals"] == 1 and found["area"] == 2 and found["division"] == pytest.approx(2)
    assert same(whole, whole)


def test_patterns_of_other_resolutions_are_refused() -> None:
    with pytest.raises(BadInput, match="resolution"):
        distances(describe(slabs((0.0,)), HIT), describe(slabs((0.0,), SMALL), HIT))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 99), st.integers(0, 99), st.integers(1, 12), st.integers(1, 12))
def test_distances_are_symmetric_and_vanish_for_equals(seed: int, other: int, m: int, n: int) -> None:
    a, b = describe(cells(seed, m), HIT), describe(cells(other, n), HIT)
    there, back = distances(a, b), distances(b, a)
    assert there == pytest.approx(back, abs=1e-9)
    assert all(value >= 0 for value in there.values())
    assert max(there[name] for name in ("volumes", "normals")) <= 1 + 1e-9
    assert same(a, a)


@settings(max_examples=15, deadline=None)
@given(UNIT, st.floats(-0.3, 0.3))
def test_any_plane_keeps_its_area(normal: np.ndarray, offset: float) -> None:
    centres = SMALL.centres()
    labels = np.where(np.linalg.norm(centres, axis=-1) < 0.9, 1 + (centres @ normal > offset), 0)
    area, shares = crack_surface(labels.astype(np.int32), SMALL.spacing)
    assert area == pytest.approx(np.pi * (0.9**2 - offset**2), rel=0.1)
    assert shares.sum() == pytest.approx(1)
