"""Which training pattern suits an impact."""

from __future__ import annotations

import numpy as np
import pytest

from deepfracture.carve import voronoi_pattern
from deepfracture.compare import describe
from deepfracture.learn.partition.selector import ImpulseKernel, MinimumRiskSelector, fit_kernel, pairwise_distances
from deepfracture.types import Floats32, Grid, Impact


def rows_at(x: np.ndarray) -> Floats32:
    rows = np.zeros((len(x), 1, 7), np.float32)
    rows[:, 0, 0] = x
    return rows


def outcomes(rng: np.random.Generator, n: int) -> tuple[Floats32, Floats32]:
    """Blows along a line, and outcomes that follow them with much noise: rows, and distances between outcomes."""
    x = rng.uniform(-1, 1, n)
    value = 3 * x + rng.normal(size=n)
    return rows_at(x), np.abs(value[:, None] - value).astype(np.float32)


def test_the_typical_beats_the_nearest() -> None:
    """Half of all squared noise is the recalled pattern's own; a typical one has little."""
    rng = np.random.default_rng(0)
    rows, apart = outcomes(rng, 300)
    known, asked = np.arange(200), np.arange(200, 300)
    select = MinimumRiskSelector(
        rows[known], np.zeros((200, 8), np.float32), apart[:200, :200], fit_kernel(rows[known], apart[:200, :200])
    )
    typical = [select(rows[k], np.zeros(8, np.float32))[0] for k in asked]
    nearest = [int(np.abs(rows[known, 0, 0] - rows[k, 0, 0]).argmin()) for k in asked]
    assert apart[asked, typical].mean() < 0.85 * apart[asked, nearest].mean()


def test_a_narrow_similarity_recalls_the_nearest() -> None:
    rows, apart = outcomes(np.random.default_rng(1), 50)
    select = MinimumRiskSelector(rows, np.zeros((50, 8), np.float32), apart, ImpulseKernel(0.0, 1.0, 1e-3))
    for k in (0, 17, 49):
        assert select(rows[k], np.zeros(8, np.float32))[0] == k


def test_random_codes_choose_among_what_similar_blows_did() -> None:
    rng = np.random.default_rng(2)
    rows, apart = outcomes(rng, 200)
    segment = rng.normal(size=(200, 8)).astype(np.float32)
    select = MinimumRiskSelector(rows, segment, apart, ImpulseKernel(0.0, 1.0, 0.2))
    draws = [rng.normal(size=8).astype(np.float32) for _ in range(30)]

    def chosen(bandwidth: float) -> np.ndarray:
        return np.array([select(rows[3], draw, bandwidth=bandwidth)[0] for draw in draws])

    assert len(set(chosen(1e6))) == 1
    assert len(set(chosen(1.0))) > 5
    assert np.abs(rows[chosen(1.0), 0, 0] - rows[3, 0, 0]).mean() < 0.4


def test_far_from_all_witnesses_the_mean_of_all_decides() -> None:
    rows, apart = outcomes(np.random.default_rng(3), 40)
    select = MinimumRiskSelector(rows, np.zeros((40, 8), np.float32), apart, ImpulseKernel(0.0, 1.0, 0.01))
    assert select(rows_at(np.array([9.0]))[0], np.zeros(8, np.float32))[0] == apart.mean(axis=0).argmin()


def test_the_fit_finds_what_matters() -> None:
    """Outcomes that depend on the impulse alone make its weight large."""
    rng = np.random.default_rng(4)
    rows = np.zeros((150, 1, 7), np.float32)
    rows[:, 0, :3] = rng.uniform(-1, 1, (150, 3))
    rows[:, 0, 6] = rng.uniform(-1, 1, 150)
    value = rows[:, 0, 6] + 0.05 * rng.normal(size=150)
    found = fit_kernel(rows, np.abs(value[:, None] - value).astype(np.float32))
    assert found.impulse == 4.0


def test_distances_are_in_units_of_their_mean() -> None:
    grid = Grid(32)
    ball = (0.9 - np.linalg.norm(grid.centres(), axis=-1)).astype(np.float32)
    rng = np.random.default_rng(5)
    hit = Impact([[0.9, 0, 0]], [[-1.0, 0, 0]], [100.0], [[1.0, 0, 0]], speed=3.0, radius=0.2)
    patterns = [voronoi_pattern(rng.uniform(-0.6, 0.6, (n, 3)), ball > 0, grid) for n in (3, 5, 9, 9)]
    apart = pairwise_distances([describe(pattern, hit) for pattern in [*patterns, patterns[0]]])
    assert apart.shape == (5, 5)
    assert apart[0, 4] == 0 and (np.diag(apart) == 0).all()
    assert (apart == apart.T).all()
    assert apart.sum() / 20 == pytest.approx(1.0, abs=1e-5)
