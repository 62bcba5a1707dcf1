"""Convex parts cover the solid, hardly more, and those of neighbours stay apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay

from deepfracture.geometry import builtin, signed_distance_points
from deepfracture.types import Mesh
from deepfracture.world.hulls import WHOLE_PARTS, piece_hulls, whole_hulls


@pytest.mark.parametrize(("name", "air"), [("bar", 1e-6), ("mug", 0.1), ("pot", 0.17), ("letter_a", 0.08)])
def test_parts_fill_a_shape_and_little_more(name: str, air: float) -> None:
    mesh = builtin(name).mesh
    hulls = whole_hulls(mesh)
    volume = sum(ConvexHull(points).volume for points in hulls.points)
    assert len(hulls.points) <= WHOLE_PARTS
    assert max(len(points) for points in hulls.points) <= 160
    assert -0.02 < volume / mesh.volume - 1 < air
    # Wherever there is solid near the surface there is a part.
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (20000, 3))
    depth = signed_distance_points(mesh, points)
    shallow = points[(depth > 0.02) & (depth < 0.05)]
    inside = np.zeros(len(shallow), bool)
    for part in hulls.points:
        inside |= Delaunay(part).find_simplex(shallow) >= 0
    assert len(shallow) > 50
    assert inside.mean() > 0.97


def test_a_shape_is_decomposed_once() -> None:
    mesh = builtin("bar").mesh
    assert whole_hulls(mesh) is whole_hulls(mesh)


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    return Mesh(low + corners * (np.array(high) - low), faces)


def test_a_convex_piece_is_one_hull_shrunk_towards_its_centre() -> None:
    (hull,) = piece_hulls([_box((0, 0, 0), (1, 2, 0.5))])
    assert len(hull.points) == 1
    low, high = hull.points[0].min(axis=0), hull.points[0].max(axis=0)
    assert (low > 0).all()
    assert (low < 0.006).all()
    np.testing.assert_allclose(low + high, [1, 2, 0.5], atol=1e-9)


def test_a_round_piece_keeps_its_roundness() -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    (hull,) = piece_hulls([Mesh(ball.vertices, ball.faces)])
    (points,) = hull.points
    faces = ConvexHull(points).equations
    assert -faces[:, 3].max() > 0.49  # every face of the hull is that far out


def test_pieces_that_lie_in_each_other_do_not_collide_at_birth() -> None:
    """An L and the block in its corner: the hull of the L would cover half of the block."""
    import manifold3d

    corner = manifold3d.Manifold.cube([2, 2, 1]) - manifold3d.Manifold.cube([1.6, 1.6, 1]).translate([0.4, 0.4, 0])
    raw = corner.to_mesh()
    letter = Mesh(np.asarray(raw.vert_properties, float)[:, :3], np.asarray(raw.tri_verts, np.int64))
    (parts,) = piece_hulls([letter])
    assert len(parts.points) > 1
    assert parts.excess < 0.2
    inside = np.random.default_rng(0).uniform([0.5, 0.5, 0], [1.9, 1.9, 1], (2000, 3))
    covered = np.zeros(len(inside), bool)
    for points in parts.points:
        covered |= Delaunay(points).find_simplex(inside) >= 0
    assert covered.mean() < 0.15
