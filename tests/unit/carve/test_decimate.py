"""Cracks with fewer triangles, still the same from both sides."""

from __future__ import annotations

import numpy as np
import pytest

from deepfracture.carve import cut, decimated, voronoi_pattern
from deepfracture.geometry import builtin, mass_properties, signed_distance
from deepfracture.types import BadInput, Fragments, Grid
from deepfracture.validation.fragments import check_fragments

SHAPE, GRID = builtin("bar"), Grid(32)


@pytest.fixture(scope="module")
def fragments() -> Fragments:
    surface = signed_distance(SHAPE.mesh, GRID)
    inside = GRID.centres()[surface > 0]
    sites = np.random.default_rng(4).choice(inside, 9, replace=False)
    return cut(SHAPE, voronoi_pattern(sites, surface > 0, GRID), density=1000.0)


def inner(fragments: Fragments) -> int:
    return sum(int((piece.source < 0).sum()) for piece in fragments)


def outside(fragments: Fragments) -> list[np.ndarray]:
    return [piece.mesh.triangles[piece.source >= 0] for piece in fragments]


def test_a_budget_is_met_by_the_cracks_alone_and_everything_still_fits(fragments: Fragments) -> None:
    least = max(len(piece.mesh.faces) for piece in decimated(fragments, 4))
    budget = least + 60
    assert max(len(piece.mesh.faces) for piece in fragments) > budget
    coarse = decimated(fragments, budget)
    assert max(len(piece.mesh.faces) for piece in coarse) <= budget
    assert not check_fragments(SHAPE, coarse, voxel=GRID.spacing).failures
    for before, after in zip(outside(fragments), outside(coarse), strict=True):
        np.testing.assert_array_equal(before, after)
    for piece in coarse:
        have = mass_properties(piece.mesh, 1000.0)
        assert piece.mass == pytest.approx(have.mass)
        np.testing.assert_allclose(piece.centre, have.centre)
        np.testing.assert_allclose(piece.inertia, have.inertia)


def test_as_few_as_can_be_keep_volume_and_fit(fragments: Fragments) -> None:
    coarse = decimated(fragments, 4)
    assert inner(coarse) < 0.6 * inner(fragments)
    assert not check_fragments(SHAPE, coarse, voxel=GRID.spacing).failures
    for before, after in zip(fragments, coarse, strict=True):
        assert after.volume == pytest.approx(before.volume, rel=0.1)


def test_within_the_budget_nothing_changes_and_the_same_comes_out_twice(fragments: Fragments) -> None:
    assert decimated(fragments, 1_000_000) is fragments
    one, two = decimated(fragments, 200), decimated(fragments, 200)
    for a, b in zip(one, two, strict=True):
        assert a.mesh.vertices.tobytes() == b.mesh.vertices.tobytes()
        assert a.mesh.faces.tobytes() == b.mesh.faces.tobytes()


def test_few_vertices_are_left_within_a_flat_crack() -> None:
    surface = signed_distance(SHAPE.mesh, GRID)
    halves = cut(SHAPE, voronoi_pattern(np.array([[-0.5, 0, 0], [0.51, 0, 0]]), surface > 0, GRID), density=1.0)

    def within(fragments: Fragments) -> int:
        piece = fragments.pieces[0]
        rim, crack = (piece.mesh.faces[own] for own in (piece.source >= 0, piece.source < 0))
        return len(np.setdiff1d(crack, rim))

    assert within(decimated(halves, 4)) < 0.4 * within(halves)


def test_a_budget_below_a_tetrahedron_is_refused(fragments: Fragments) -> None:
    with pytest.raises(BadInput, match="at least 4 triangles a fragment, got 3"):
        decimated(fragments, 3)
