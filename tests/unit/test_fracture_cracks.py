"""Cracks: what physics demands of any simulator of this kind, on the bar, which is quick to prepare."""

import numpy as np
import pytest

from deepfracture.fracture import material, prepare_body, simulate
from deepfracture.fracture.lattice import Lattice
from deepfracture.fracture.separate import fragments_of, merge_dust
from deepfracture.fracture.variation import random_field
from deepfracture.geometry import builtin
from deepfracture.types import Grid, Impact

PLASTER = material("plaster")


@pytest.fixture(scope="module")
def bar():
    return prepare_body(builtin("bar"), PLASTER, Grid(32))


def hit(x: float, speed: float, ball_mass: float = 261.0) -> Impact:
    """A steel ball of 0.2 m on the top face of the bar (2 x 0.4 x 0.4 m) at `x`, perfectly inelastic."""
    body = 0.32 * PLASTER.density
    impulse = speed * ball_mass * body / (ball_mass + body)
    return Impact(
        position=np.array([[x, 0.0, 0.2]]), direction=np.array([[0.0, 0.0, -1.0]]), magnitude=np.array([impulse]),
        normal=np.array([[0.0, 0.0, 1.0]]), speed=speed, radius=0.2,
    )  # fmt: skip


def broken(body, impact, seed=0):
    return simulate(body, impact, np.random.default_rng(seed))


def test_nothing_breaks_below_the_criterion(bar) -> None:
    assert broken(bar, hit(0.1, 0.2)) is None


def test_a_hard_hit_breaks_and_every_voxel_belongs_to_a_fragment(bar) -> None:
    pattern = broken(bar, hit(0.1, 16.0)).pattern
    inside = bar.sdf[4:-4, 4:-4, 4:-4] > 0
    assert pattern.count >= 3
    assert ((pattern.labels > 0) == inside).all()
    assert set(np.unique(pattern.labels)) == set(range(pattern.count + 1))


def test_the_same_generator_state_gives_the_same_fragments(bar) -> None:
    one, two, other = (broken(bar, hit(0.1, 16.0), seed).pattern for seed in (3, 3, 4))
    assert one.labels.tobytes() == two.labels.tobytes()
    assert one.distance.tobytes() == two.distance.tobytes()
    assert one.labels.tobytes() != other.labels.tobytes()


def test_more_impulse_gives_more_fragments(bar) -> None:
    counts = []
    for speed in (3.0, 10.0, 25.0):
        results = [broken(bar, hit(0.1, speed), seed) for seed in range(3)]
        counts.append(np.mean([result.pattern.count if result else 1 for result in results]))
    assert counts[0] < counts[1] < counts[2]


def test_hits_in_different_places_break_different_places(bar) -> None:
    x = bar.grid.centres()[..., 0]

    def mean_crack(at: float) -> float:
        """Mean x of the voxels that lie beside a crack, over a few materials."""
        results = [broken(bar, hit(at, 6.0), seed) for seed in range(4)]
        patterns = [result.pattern for result in results if result]
        assert len(patterns) >= 2
        near = [(p.labels > 0) & (p.distance < bar.grid.spacing) for p in patterns]
        return float(np.mean([x[beside].mean() for beside in near]))

    assert mean_crack(-0.6) < -0.3
    assert -0.2 < mean_crack(0.0) < 0.2
    assert mean_crack(0.6) > 0.3


def test_a_tougher_bar_does_not_crack_further(bar) -> None:
    from dataclasses import replace

    area = []
    for factor in (1.0, 30.0):
        tough = replace(bar, material=replace(PLASTER, toughness=PLASTER.toughness * factor))
        result = broken(tough, hit(0.1, 12.0))
        near = result.pattern.distance[result.pattern.labels > 0] < bar.grid.spacing if result else np.zeros(1)
        area.append(near.sum())
    assert area[1] < area[0]


def test_crack_distance_is_small_exactly_beside_label_changes(bar) -> None:
    pattern = broken(bar, hit(0.1, 16.0)).pattern
    labels, h = pattern.labels, bar.grid.spacing
    for axis in range(3):
        a, d = np.moveaxis(labels, axis, 0), np.moveaxis(pattern.distance, axis, 0)
        parted = (a[:-1] != a[1:]) & (a[:-1] > 0) & (a[1:] > 0)
        assert (d[:-1][parted] <= h * 1.001).all()
        assert (d[:-1][parted] + d[1:][parted] <= 1.5 * h).mean() > 0.9


def test_flooding_stops_at_cut_faces_only() -> None:
    inside = np.zeros((8, 8, 8), bool)
    inside[1:7, 1:7, 1:7] = True
    cut = np.zeros(inside.shape, np.uint8)
    cut[3, 1:7, 1:7] = 1
    labels = fragments_of(inside, cut, 1)
    assert sorted(np.bincount(labels.ravel())[1:]) == [108, 108]
    cut[3, 3, 3] = 0  # one face holds: both sides are still one piece
    assert fragments_of(inside, cut, 1).max() == 1


def test_dust_joins_the_neighbour_it_touches_most() -> None:
    labels = np.zeros((4, 6, 6), np.int32)
    labels[:, :3], labels[:, 3:] = 1, 2
    labels[1, 2, 2:4] = 3  # 2 faces to label 2, more to label 1
    merged = merge_dust(labels, 5)
    assert merged.max() == 2
    assert (merged == np.where(labels == 2, 2, 1)).all()


def test_dust_that_touches_nothing_stays() -> None:
    labels = np.zeros((5, 5, 5), np.int32)
    labels[0, 0, 0], labels[3:, 3:, 3:] = 1, 2
    assert merge_dust(labels, 4).max() == 2


def test_random_fields_have_unit_variance_and_the_length_asked_for() -> None:
    lattice = Lattice(40, 0.05, -1.0)
    fields = [random_field(lattice, 0.2, np.random.default_rng(seed)) for seed in range(8)]
    correlation = [float(np.mean(f * np.roll(f, 4, axis=0))) for f in fields]  # at a distance of 0.2
    assert np.std(fields[0]) == pytest.approx(1, abs=1e-3)
    # white noise smoothed to exp(-d^2 / (2 length^2)): e^-1/2 at d = length
    assert np.mean(correlation) == pytest.approx(np.exp(-0.5), abs=0.06)
