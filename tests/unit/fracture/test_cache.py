"""What is kept on disk comes back to the byte, and damage costs time alone."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from deepfracture.fracture import FractureBody, material, prepare_body
from deepfracture.fracture.body import OUTER_BAND
from deepfracture.fracture.cache import MAX_FILES, cache_folder, cached_distances
from deepfracture.fracture.padded_grid import PaddedGrid
from deepfracture.geometry import load_shape, signed_distance_lattice
from deepfracture.runtime.progress import collect_stages
from deepfracture.types import Grid

FIELDS = ("sdf", "centres", "cells", "nearest_cell", "thickness")


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return cache_folder()


def body() -> tuple[FractureBody, list[str]]:
    with collect_stages() as stages:
        made = prepare_body(load_shape("bar"), material("plaster"), Grid(32))
    return made, [done.stage for done in stages]


def test_the_second_preparation_reads_what_the_first_wrote(kept: Path) -> None:
    first, worked = body()
    second, again = body()
    assert {"remesh", "boundary elements", "distances"} == set(worked)
    assert again == []
    for name in FIELDS:
        assert (getattr(first, name) == getattr(second, name)).all(), name
    assert (first.elastic.factor == second.elastic.factor).all()
    assert not list(kept.glob("*.tmp")) and not list(kept.glob(".*"))


def test_damaged_files_are_made_anew(kept: Path, caplog: pytest.LogCaptureFixture) -> None:
    first, _ = body()
    for path in kept.glob("*.distances"):
        path.write_bytes(path.read_bytes()[:100])
    second, again = body()
    assert again == ["distances", "distances"]
    assert "not a saved distance field" in caplog.text
    assert (first.sdf == second.sdf).all()


def test_other_lattices_and_limits_are_kept_apart(kept: Path) -> None:
    mesh, fine = load_shape("bar").mesh, PaddedGrid.fine(Grid(32))
    near = cached_distances(mesh, fine, outside=0.1)
    far = cached_distances(mesh, fine, outside=np.inf)
    coarse = cached_distances(mesh, fine.coarsened(20), outside=0.1)
    assert near.min() == np.float32(-0.1) > far.min()
    assert coarse.shape == (20, 20, 20)
    assert len(list(kept.glob("*.distances"))) == 3


def test_distances_are_exact_where_cracks_run() -> None:
    made, _ = body()
    fine = made.fine
    exact = signed_distance_lattice(made.shape.mesh, np.full(3, fine.first_centre), fine.spacing, fine.shape)
    assert (made.sdf == np.maximum(exact, np.float32(-OUTER_BAND * fine.spacing))).all()


def test_the_least_used_files_make_room(kept: Path) -> None:
    mesh = load_shape("bar").mesh
    for n in range(MAX_FILES + 2):
        cached_distances(mesh, PaddedGrid(8 + n, 0.3, -1.2), outside=0.1)
        for age, path in enumerate(sorted(kept.glob("*.distances"), key=lambda p: p.stat().st_mtime_ns, reverse=True)):
            os.utime(path, (1000 - age, 1000 - age))
    assert len(list(kept.glob("*.distances"))) == MAX_FILES
    cached_distances(mesh, PaddedGrid(8 + MAX_FILES + 1, 0.3, -1.2), outside=0.1)
    assert len(list(kept.glob("*.distances"))) == MAX_FILES
