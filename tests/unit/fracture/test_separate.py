"""Dust that touches dust: where the pieces of a chain of merges end."""

from __future__ import annotations

import numpy as np
import pytest

from deepfracture.voxels import merge_small_components


def test_a_row_of_dust_ends_in_one_piece() -> None:
    labels = np.zeros((3, 3, 40), np.int32)
    labels[1, 1, :20] = np.arange(1, 21)
    labels[1, 1, 20:] = 21
    assert (merge_small_components(labels, 1000) == (labels > 0)).all()


@pytest.mark.parametrize("seed", range(3))
def test_pieces_only_grow_and_none_stays_dust_beside_a_neighbour(seed: int) -> None:
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.repeat(rng.integers(0, 30, (6, 6, 6)), 3, axis=0), 2, axis=1).astype(np.int32)
    merged = merge_small_components(labels, 60)
    assert ((merged > 0) == (labels > 0)).all()
    assert set(np.unique(merged)) == set(range(merged.max() + 1))
    for piece in np.unique(labels[labels > 0]):
        assert len(np.unique(merged[labels == piece])) == 1
    touching = {
        int(a)
        for axis in range(3)
        for low, high in [(np.moveaxis(merged, axis, 0)[:-1], np.moveaxis(merged, axis, 0)[1:])]
        for a in np.concatenate([m[(low != high) & (low > 0) & (high > 0)] for m in (low, high)])
    }
    assert all(np.count_nonzero(merged == piece) >= 60 for piece in touching)
