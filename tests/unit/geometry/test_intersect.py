"""Self-intersections: constructed cases, and random triangles against exact rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest

from deepfracture.geometry import builtin, intersect
from deepfracture.geometry.intersect import (
    TOUCH_TOL,
    _boxes,
    _on_one_side,
    _triangles_intersect,
    _unit_normals,
    self_intersections,
)
from deepfracture.types import BadInput, Mesh
from deepfracture.validation.meshes import box, concatenated, icosphere

CUBE = box((1, 1, 1), (3, 3, 3))
PLATE = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]


def pairs(*triangles) -> list[list[int]]:
    """Crossing pairs of triangles that share nothing but positions."""
    return self_intersections(
        Mesh(np.reshape(triangles, (-1, 3)), np.arange(3 * len(triangles)).reshape(-1, 3))
    ).tolist()


def turned(mesh: Mesh, *, seed: int = 0) -> Mesh:
    """Not aligned with any axis, and away from the origin."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return Mesh(mesh.vertices @ turn + [0.3, 0.2, 0.1], mesh.faces)


@pytest.mark.parametrize("mesh", [icosphere(8), CUBE, turned(CUBE), builtin("chair").mesh, turned(builtin("mug").mesh)])
def test_sound_surfaces_do_not_cross_themselves(mesh: Mesh) -> None:
    assert len(self_intersections(mesh)) == 0


def test_two_cubes_that_run_into_each_other_cross_each_other_only() -> None:
    shift = np.array([0.41, 0.37, 0.33])
    found = self_intersections(turned(concatenated(CUBE, CUBE.moved(1.0, shift))))
    n = len(CUBE.faces)
    assert len(found) > 0
    assert (found[:, 0] < n).all()
    assert (found[:, 1] >= n).all()
    assert (np.diff(found[:, 0]) >= 0).all()
    apart = self_intersections(turned(concatenated(CUBE, CUBE.moved(1.0, [1.2, 0, 0]))))
    assert len(apart) == 0


def test_cubes_face_to_face_overlap_and_corner_to_corner_do_not() -> None:
    n = len(CUBE.faces)
    beside = self_intersections(turned(concatenated(CUBE, CUBE.moved(1.0, [1.0, 0, 0]))))
    assert len(beside) >= 18  # a side has 18 faces, each has its double
    assert (beside[:, 0] < n).all() and (beside[:, 1] >= n).all()
    assert len(self_intersections(turned(concatenated(CUBE, CUBE.moved(1.0, [1.0, 1.0, 1.0]))))) == 0
    assert len(self_intersections(turned(concatenated(CUBE, CUBE.moved(1.0, [1.0, 1.0, 0]))))) == 0


def test_a_folded_strip_overlaps_only_when_it_is_folded_flat() -> None:
    def folded(angle: float) -> Mesh:
        tip = [0.6, np.cos(angle), np.sin(angle)]
        return turned(Mesh([(0, 0, 0), (1, 0, 0), (0.4, 1, 0), tip], [(0, 1, 2), (1, 0, 3)]))

    assert self_intersections(folded(0.0)).tolist() == [[0, 1]]
    assert self_intersections(folded(1e-14)).tolist() == [[0, 1]]
    for angle in (1e-10, 0.5, np.pi - 1e-6, np.pi, np.pi + 1e-6):
        assert len(self_intersections(folded(angle))) == 0


def test_faces_that_share_a_vertex_cross_elsewhere() -> None:
    through = [(0, 0, 0), (0.5, 0.5, 0.5), (0.4, 0.2, -0.5)]
    above = [(0, 0, 0), (0.5, 0.5, 0.5), (0.4, 0.2, 0.0)]
    assert pairs(PLATE, through) == [[0, 1]]
    assert pairs(PLATE, above) == []
    beside = [(0, 0, 0), (-0.5, -0.5, 0), (0.5, -0.5, 0)]
    across = [(0, 0, 0), (0.5, 0.2, 0), (0.2, 0.9, 0)]
    assert pairs(PLATE, beside) == []
    assert pairs(PLATE, across) == [[0, 1]]


def test_a_pinched_cone_touches_itself_and_a_pushed_one_crosses() -> None:
    """Two cones tip to tip; then one tip inside the other."""

    def cones(overlap: float) -> Mesh:
        angle = 2 * np.pi * np.arange(7) / 7
        ring = np.column_stack([np.cos(angle), np.sin(angle), np.ones(7)])
        faces = [(0, 1 + i, 1 + (i + 1) % 7) for i in range(7)] + [(8, 1 + (i + 1) % 7, 1 + i) for i in range(7)]
        cone = Mesh(np.concatenate([[(0, 0, 0)], ring, [(0, 0, 1)]]), faces)
        other = Mesh(cone.vertices * [1, 1, -1] + [0.01 * overlap, 0.02 * overlap, overlap], cone.faces[:, ::-1])
        return turned(concatenated(cone, other))

    assert len(self_intersections(cones(0.0))) == 0
    assert len(self_intersections(cones(TOUCH_TOL / 4))) == 0
    assert len(self_intersections(cones(0.1))) >= 7


@pytest.mark.parametrize(
    ("other", "crosses"),
    [
        ([(0.2, 0.2, 0), (0.2, 0.3, 1), (0.3, 0.2, 1)], False),  # a tip on the face
        ([(0.2, 0.2, -1e-10), (0.2, 0.3, 1), (0.3, 0.2, 1)], False),  # within rounding of it
        ([(0.2, 0.2, -1e-7), (0.2, 0.3, 1), (0.3, 0.2, 1)], True),
        ([(0.1, 0.2, 0), (0.4, 0.3, 0), (0.3, 0.2, 1)], False),  # a side on the face
        ([(0.5, -1, -1), (0.5, 1, 1), (0.6, -1, -0.5)], False),  # below and beside: the planes cross, the faces do not
        ([(0.5, -1, 0), (0.5, 0, 0), (0.6, -1, 0)], False),  # in one plane, side by side
        ([(0.5, -1, 0), (0.5, 0.01, 0), (0.6, -1, 0)], True),
        ([(0.1, 0.1, 0), (0.2, 0.1, 0), (0.1, 0.2, 0)], True),  # inside the other, in one plane
        ([(0.1, 0.1, 1e-7), (0.2, 0.1, 1e-7), (0.1, 0.2, 1e-7)], False),  # a little above
        ([(0.1, 0.1, -1), (0.1, 0.1, 1), (0.1, 0.1, 0)], False),  # without area: left out
    ],
)
def test_touching_is_not_crossing(other, crosses: bool) -> None:
    assert pairs(PLATE, other) == ([[0, 1]] if crosses else [])
    assert pairs(other, PLATE) == ([[0, 1]] if crosses else [])


def test_doubled_faces_overlap_whichever_way_they_face() -> None:
    assert pairs(PLATE, PLATE) == [[0, 1]]
    assert pairs(PLATE, PLATE[::-1]) == [[0, 1]]


def pierces(p, q) -> bool:
    """Whether a side of p runs through the inside of q: exact, for triangles in general position."""

    def volume(a, b, c, d):
        (ux, uy, uz), (vx, vy, vz), (wx, wy, wz) = (
            [Fraction(float(x)) - Fraction(float(o)) for x, o in zip(point, a, strict=True)] for point in (b, c, d)
        )
        return ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)

    for a, b in ((p[0], p[1]), (p[1], p[2]), (p[2], p[0])):
        if (volume(*q, a) > 0) == (volume(*q, b) > 0):
            continue
        turns = {volume(a, b, q[k], q[(k + 1) % 3]) > 0 for k in range(3)}
        if len(turns) == 1:
            return True
    return False


@pytest.mark.parametrize("size", [0.2, 0.6])
def test_random_triangles_agree_with_exact_arithmetic(size: float) -> None:
    rng = np.random.default_rng(7)
    triangles = rng.uniform(-1, 1, (60, 1, 3)) + size * rng.normal(size=(60, 3, 3))
    exact = [
        [i, j] for i, j in combinations(range(60), 2)
        if pierces(triangles[i], triangles[j]) or pierces(triangles[j], triangles[i])
    ]  # fmt: skip
    assert len(exact) > 5
    assert pairs(*triangles) == exact


def test_few_faces_and_bad_tolerances() -> None:
    assert self_intersections(Mesh(np.zeros((3, 3)), np.zeros((0, 3), int))).shape == (0, 2)
    with pytest.raises(BadInput, match="tolerance must be positive"):
        self_intersections(CUBE, tolerance=0.0)


def test_the_quick_look_beside_a_plane_never_hides_a_crossing():
    rng, looked = np.random.default_rng(0), 0
    for round_ in range(30):
        points = rng.random((40, 3)) * rng.choice([1, 1e-3, 1e-6], (40, 1))
        if round_ % 3 == 0:  # much in common planes
            points = np.round(points * 4) / 4
        corners = points[rng.integers(0, 40, (40, 3))]
        (low, high), normals = _boxes(corners, TOUCH_TOL), _unit_normals(corners)
        whole = np.flatnonzero(low[:, 0] <= high[:, 0])
        for s in whole:
            for t in whole:
                if s != t and _on_one_side(normals, corners, s, t, TOUCH_TOL):
                    looked += 1
                    assert not _triangles_intersect(corners[s], corners[t], TOUCH_TOL)
    assert looked > 5000


@pytest.mark.parametrize("spread", [0.02, 0.3, 3.0])
def test_faces_round_a_hub_cross_as_all_others_do(spread: float, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, n = np.random.default_rng(3), 2 * intersect.HUB_VALENCE
    rim = [rng.normal(size=(n, 1, 3)) + spread * rng.normal(size=(n, 2, 3)) for _ in range(2)]
    rim[0][:9] = [(1, 0, 0), (-1, 0.01, 0)]  # wide, and one upon the other
    rim[1][:20, 1] = rim[1][1:21, 0]  # neighbours
    tips = np.array([[0, 0, 0], [0.4, 0.2, 0.1]])
    points = np.concatenate([tips, *(part.reshape(-1, 3) + tip for part, tip in zip(rim, tips, strict=True))])
    corner = 2 + np.arange(4 * n).reshape(-1, 2)
    mesh = turned(Mesh(points, np.column_stack([np.repeat([0, 1], n), corner])))
    found = self_intersections(mesh)
    assert (found[:, 1] < n).sum() > 20 and (found[:, 0] >= n).sum() > 10 and len(found) > 100
    monkeypatch.setattr(intersect, "HUB_VALENCE", 10**9)
    assert np.array_equal(found, self_intersections(mesh))
    assert len(self_intersections(mesh, most=30)) == 30
