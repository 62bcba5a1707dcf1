"""Points that the cut knows to be manifold: every cell has a single fan of faces there, or none."""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from itertools import product

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, label

from deepfracture.carve import cut
from deepfracture.carve.cutting.interfaces import ONE_LOOP
from deepfracture.carve.cutting.solids import CellFaces, Solid, solids
from deepfracture.geometry import builtin, signed_distance
from deepfracture.types import FracturePattern, Grid, Mesh, Shape
from deepfracture.validation.fragments import check_fragments

GRID = Grid(32)


def pinched() -> Shape:
    """Two cones of one body whose tips meet in one vertex: round it there are two fans."""
    rim = [[np.cos(a), np.sin(a)] for a in np.arange(12) * np.pi / 6]
    points = np.array([[0, 0, 0], *([x, y, z] for z in (0.9, -0.9) for x, y in rim)])
    around = [(n, (n + 1) % 12) for n in range(12)]
    sides = [(0, 1 + a, 1 + b) for a, b in around] + [(0, 13 + b, 13 + a) for a, b in around]
    lids = [(1, 1 + b, 1 + a) for a, b in around[1:11]] + [(13, 13 + a, 13 + b) for a, b in around[1:11]]
    mesh = Mesh(points, np.array(sides + lids))
    return Shape("pinched", mesh if mesh.volume > 0 else Mesh(points, mesh.faces[:, ::-1]))


def pattern(shape: Shape, kind: str, seed: int) -> FracturePattern:
    rng, inside = np.random.default_rng(seed), signed_distance(shape.mesh, GRID) > 0
    if kind == "cells":
        sites = rng.uniform(-1, 1, (9, 3))
        labels = 1 + ((GRID.centres()[..., None, :] - sites) ** 2).sum(axis=-1).argmin(axis=-1)
    else:
        noise = rng.normal(size=(4, *GRID.shape))
        labels = 1 + np.argmax([gaussian_filter(n, 1.0 if kind == "blobs" else 0.0) for n in noise], axis=0)
    return FracturePattern(GRID, labels * inside, rng.uniform(0, GRID.spacing, GRID.shape).astype(np.float32))


def faces_of(shape: Shape, cracks: FracturePattern, monkeypatch: pytest.MonkeyPatch) -> CellFaces:
    """What the cut puts solids together from."""
    seen: list[CellFaces] = []

    def watched(faces: CellFaces, smallest: float) -> list[Solid]:
        seen.append(faces)
        return solids(faces, smallest)

    monkeypatch.setattr(sys.modules["deepfracture.carve.cutting.cut"], "solids", watched)
    cut(shape, cracks, density=1000.0)
    return seen[-1]


def fans(around: list[tuple[int, int]]) -> int:
    """Fans of the faces around a point, each by its two other corners; every one of these has to come twice."""
    assert set(Counter(n for pair in around for n in pair).values()) == {2}
    left, count = [set(pair) for pair in around], 0
    while left:
        fan, count = left.pop(), count + 1
        while touching := [pair for pair in left if pair & fan]:
            left = [pair for pair in left if not pair & fan]
            fan.update(*touching)
    return count


@pytest.mark.parametrize("kind", ["cells", "blobs", "white"])
@pytest.mark.parametrize("make", [lambda: builtin("mug"), pinched], ids=["mug", "pinched"])
def test_manifold_points_have_one_fan_of_each_cell(make, kind, monkeypatch: pytest.MonkeyPatch) -> None:
    shape = make()
    faces = faces_of(shape, pattern(shape, kind, 1), monkeypatch)
    below, above = faces.inner_cells.T
    cells = np.concatenate([faces.cell, below, above])
    corners = np.concatenate([faces.outer, faces.inner, faces.inner[:, ::-1]])
    around = defaultdict(list)
    for cell, face in zip(cells.tolist(), corners.tolist(), strict=True):
        for n in range(3):
            if faces.manifold[face[n]]:
                around[cell, face[n]].append((face[n - 2], face[n - 1]))
    assert {fans(pairs) for pairs in around.values()} == {1}
    used = np.unique(corners)
    share = faces.manifold[used].mean()
    assert share > (0.4 if kind == "cells" else 0.1)  # or else nothing is gained


def test_a_vertex_with_two_fans_is_not_manifold(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = pinched()
    assert not faces_of(shape, pattern(shape, "cells", 2), monkeypatch).manifold[0]


def test_one_loop_is_a_set_of_corners_and_its_complement_that_hang_together() -> None:
    """By labelling, wherever no face of the cube has two opposite corners of the set alone."""
    for corners in range(1, 255):
        filled = np.array([corners >> n & 1 for n in range(8)]).reshape(2, 2, 2)
        faces = [filled.take(high, axis) for axis, high in product(range(3), range(2))]
        split = any(face[0, 0] == face[1, 1] != face[0, 1] == face[1, 0] for face in faces)
        whole = label(filled)[1] == label(1 - filled)[1] == 1
        assert ONE_LOOP[corners] == (whole and not split)


@pytest.mark.parametrize("seed", range(4))
def test_a_small_solid_that_joins_a_solid_at_a_point_gets_a_vertex_of_its_own(seed: int) -> None:
    """Both are one fan there, each of its own cell: manifold for both, and yet two vertices of the solid."""
    shape = builtin("bar")
    fragments = cut(shape, pattern(shape, "white", seed), density=1000.0)
    assert check_fragments(shape, fragments, voxel=GRID.spacing).failures == {}
