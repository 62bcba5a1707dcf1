"""Fields and labels that nobody should send: one clear line, or a body that is still whole or rightly parted.

docs/carving.md has the table of what is promised."""

from __future__ import annotations

import numpy as np
import pytest

from deepfracture.carve import cut, encode, segment, segment_as_published
from deepfracture.geometry import builtin, signed_distance
from deepfracture.types import BadInput, FracturePattern, Fragments, Grid, Volume

GRID = Grid(32)
BAR = builtin("bar")
SURFACE = signed_distance(BAR.mesh, GRID)
INSIDE = SURFACE > 0
ACROSS = np.indices(GRID.shape)[0]
CHECKS = np.indices(GRID.shape).sum(axis=0) % 2
FLOODS = {
    "distances": lambda values: segment(Volume(GRID, values)),
    "published": lambda values: segment_as_published(Volume(GRID, values)),
    "no cuts": lambda values: segment(Volume(GRID, values, np.zeros(GRID.shape, np.uint8))),
}
"""Ways to segment values alone; the last is told that nothing is cut."""


def one_voxel(value: float, rest: float) -> np.ndarray:
    values = np.full(GRID.shape, rest, np.float32)
    values[16, 16, 16] = value
    return values


def pattern(labels: np.ndarray, distance: np.ndarray | float = 0.01) -> FracturePattern:
    return FracturePattern(GRID, labels, np.broadcast_to(np.asarray(distance, np.float32), GRID.shape))


def closed(fragments: Fragments) -> bool:
    """Whether each edge of each piece is there once in each direction."""
    for piece in fragments:
        ends = np.concatenate([piece.mesh.faces[:, [a, (a + 1) % 3]] for a in range(3)])
        forth, times = np.unique(ends, axis=0, return_counts=True)
        if (times > 1).any() or not np.array_equal(forth, np.unique(ends[:, ::-1], axis=0)):
            return False
    return True


def assert_whole(fragments: Fragments) -> None:
    """One piece: the body itself, not a face of it moved."""
    assert len(fragments) == 1
    (piece,) = fragments
    assert piece.volume == pytest.approx(BAR.mesh.volume, rel=1e-9)
    assert (piece.source >= 0).all()
    assert len(piece.mesh.faces) == len(BAR.mesh.faces)


def assert_parted(fragments: Fragments, least: int) -> None:
    assert len(fragments) >= least
    assert closed(fragments)
    assert all(piece.volume > 0 for piece in fragments)
    assert fragments.volume == pytest.approx(BAR.mesh.volume, rel=1e-6)


@pytest.mark.parametrize("way", FLOODS)
@pytest.mark.parametrize(
    ("values", "count"),
    [
        (np.full(GRID.shape, -1.0), 0),
        (np.zeros(GRID.shape), 0),
        (np.full(GRID.shape, -1e-30), 0),
        (np.full(GRID.shape, 1.0), 1),
        (np.full(GRID.shape, 1e-30), 1),
        (np.full(GRID.shape, 3e38), 1),
        (one_voxel(0.5, -1.0), 1),
        (one_voxel(1e-6, 0.0), 1),
        (one_voxel(-1.0, 1.0), 1),
    ],
    ids=["negative", "zero", "just negative", "positive", "just positive", "huge", "voxel", "faint voxel", "hole"],
)
def test_values_without_a_crack_are_one_piece_or_none(way: str, values: np.ndarray, count: int) -> None:
    found = FLOODS[way](values)
    assert found.count == count
    np.testing.assert_array_equal(found.labels > 0, values > 0)
    assert_whole(cut(BAR, found, density=1.0))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_in_one_line(wrong: float) -> None:
    values = np.where(CHECKS, SURFACE, np.float32(wrong))
    with pytest.raises(BadInput, match="values must be finite") as refused:
        Volume(GRID, values)
    assert "\n" not in str(refused.value)
    with pytest.raises(BadInput, match="must be finite"):
        encode(pattern(INSIDE), values)
    with pytest.raises(BadInput, match="distance must be"):
        pattern(INSIDE, values)


@pytest.mark.parametrize("density", [0.0, -1.0, np.nan])
def test_an_impossible_density_is_refused(density: float) -> None:
    with pytest.raises(BadInput, match="density"):
        cut(BAR, pattern(INSIDE), density=density)


@pytest.mark.parametrize("way", FLOODS)
@pytest.mark.parametrize("depth", [0.02, 0.5])
def test_a_field_that_alternates_voxel_by_voxel_is_divided_without_a_rest(way: str, depth: float) -> None:
    """Whether its voxels hang together is nobody's to say: the cage joins the shallow ones, edges join dust."""
    values = np.where(CHECKS, depth, -depth)
    found = FLOODS[way](values)
    np.testing.assert_array_equal(found.labels > 0, values > 0)
    if way == "no cuts":
        assert found.count == 1
    if way == "published" and depth > 0.04:
        assert found.count == CHECKS.sum()
    assert_parted(cut(BAR, found, density=1.0), least=1)


def test_labels_that_alternate_voxel_by_voxel_are_dust_and_join() -> None:
    labels = np.where(INSIDE, 1 + CHECKS, 0)
    assert segment(encode(pattern(labels), SURFACE)).count == 1
    assert segment(encode(pattern(labels), SURFACE), min_voxels=1).count == INSIDE.sum()
    assert_parted(cut(BAR, pattern(labels), density=1.0), least=1)


@pytest.mark.parametrize("distance", [0.0, 1e-30, 1e-6, 0.03, 1e30])
def test_slabs_a_voxel_wide_come_apart_whatever_the_distances_say(distance: float) -> None:
    labels = np.where(INSIDE, 1 + ACROSS, 0)
    found = segment(encode(pattern(labels, distance), SURFACE))
    assert found.count == len(np.unique(labels[INSIDE]))
    assert_parted(cut(BAR, pattern(labels, distance), density=1.0), least=28)


def test_cuts_count_more_than_values() -> None:
    """A body without a dent in its values, but cut in the middle; and a deep furrow that nothing cuts."""
    cuts = np.zeros(GRID.shape, np.uint8)
    cuts[15] = 1
    furrow = np.where(INSIDE & (ACROSS == 16), np.float32(1e-6), SURFACE)
    assert segment(Volume(GRID, SURFACE, cuts)).count == 2
    assert segment(Volume(GRID, furrow, np.zeros(GRID.shape, np.uint8))).count == 1
    assert_parted(cut(BAR, segment(Volume(GRID, SURFACE, cuts)), density=1.0), least=2)


def test_cuts_that_part_nothing_change_nothing() -> None:
    """Outside the body, past the last voxel, a face alone, and in bits that mean nothing."""
    cuts = np.where(INSIDE, 0, 7).astype(np.uint8)
    cuts[:-1] &= np.where(INSIDE[1:], 6, 7).astype(np.uint8)
    cuts[16, 16, 16] = 1
    cuts |= 0b11111000
    found = segment(Volume(GRID, SURFACE, cuts))
    assert found.count == 1
    np.testing.assert_array_equal(found.labels > 0, INSIDE)


def test_cuts_everywhere_leave_dust_that_joins() -> None:
    everywhere = np.full(GRID.shape, 7, np.uint8)
    assert segment(Volume(GRID, SURFACE, everywhere)).count == 1
    assert segment(Volume(GRID, SURFACE, everywhere), min_voxels=0).count == INSIDE.sum()


@pytest.mark.parametrize(
    "labels",
    [
        np.zeros(GRID.shape, int),
        np.where(INSIDE, 0, 1 + (ACROSS > 20)),
        one_voxel(1, 0).astype(int),
        one_voxel(2, 1).astype(int),
        np.where(INSIDE, np.iinfo(np.int32).max, 0),
    ],
    ids=["none", "outside alone", "one voxel", "one other voxel", "largest name"],
)
def test_labels_that_part_nothing_leave_the_body_whole(labels: np.ndarray) -> None:
    found = cut(BAR, pattern(labels), density=1.0)
    if (labels[INSIDE] > 0).any() or not labels.any():
        assert_whole(found)
    else:
        assert_parted(found, least=1)  # labels beside the body may reach into it


def test_names_of_labels_do_not_matter() -> None:
    last = np.iinfo(np.int32).max
    labels = np.where(INSIDE, np.where(ACROSS < 16, last, last - 1), 0)
    assert segment(encode(pattern(labels), SURFACE)).count == 2
    assert_parted(cut(BAR, pattern(labels), density=1.0), least=2)
    assert len(cut(BAR, pattern(labels), density=1.0)) == 2


def test_negative_labels_and_other_shapes_are_refused() -> None:
    with pytest.raises(BadInput, match="labels must be zero or more"):
        pattern(np.full(GRID.shape, -1))
    with pytest.raises(BadInput, match="labels must have shape"):
        FracturePattern(GRID, np.zeros((8, 8, 8)), np.zeros(GRID.shape))
    with pytest.raises(BadInput, match="cuts must have shape"):
        Volume(GRID, SURFACE, np.zeros((8, 8, 8), np.uint8))


def test_thousands_of_labels_come_apart_and_lose_nothing() -> None:
    """Blocks of 2 x 2 x 2 voxels, those at the surface smaller."""
    grid = Grid(64)
    index = np.indices(grid.shape) // 2
    labels = 1 + index[0] + 32 * index[1] + 1024 * index[2]
    inside = signed_distance(BAR.mesh, grid) > 0
    labels = np.where(inside, labels, 0)
    assert len(np.unique(labels[inside])) > 1000
    found = segment(encode(FracturePattern(grid, labels, np.full(grid.shape, 0.01)), signed_distance(BAR.mesh, grid)))
    assert found.count == len(np.unique(labels[inside]))
    assert_parted(cut(BAR, found, density=1.0), least=500)  # those cut off by the surface are dust
