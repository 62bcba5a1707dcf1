"""Convex parts cover the solid, hardly more, and those of neighbours stay apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull, Delaunay

from deepfracture.carve import cut
from deepfracture.geometry import builtin, signed_distance, signed_distance_points
from deepfracture.geometry.convex.hulls import FRAGMENT_EXCESS, SHAPE_PARTS, fragment_hulls, shape_hulls
from deepfracture.geometry.convex.polytope import clip, corners, face_planes, least_overlap_plane, quickhull, volume
from deepfracture.types import FracturePattern, Grid, Mesh

THIN = 1e-3
"""No hull of an engine is thinner [m]: a flat one gets `FRAGMENT_HULL_TOL`, of which neighbours may cut off some."""


@pytest.mark.parametrize(("name", "air"), [("bar", 1e-6), ("mug", 0.1), ("pot", 0.17), ("letter_a", 0.08)])
def test_parts_fill_a_shape_and_little_more(name: str, air: float) -> None:
    mesh = builtin(name).mesh
    hulls = shape_hulls(mesh)
    volume = sum(ConvexHull(points).volume for points in hulls.points)
    assert len(hulls.points) <= SHAPE_PARTS
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
    assert shape_hulls(mesh) is shape_hulls(mesh)


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    return Mesh(low + corners * (np.array(high) - low), faces)


def test_a_convex_piece_is_one_hull_shrunk_towards_its_centre() -> None:
    (quickhull,) = fragment_hulls([_box((0, 0, 0), (1, 2, 0.5))])
    assert len(quickhull.points) == 1
    low, high = quickhull.points[0].min(axis=0), quickhull.points[0].max(axis=0)
    assert (low > 0).all()
    assert (low < 0.006).all()
    np.testing.assert_allclose(low + high, [1, 2, 0.5], atol=1e-9)


def test_a_round_piece_keeps_its_roundness() -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    (quickhull,) = fragment_hulls([Mesh(ball.vertices, ball.faces)])
    (points,) = quickhull.points
    faces = ConvexHull(points).equations
    assert -faces[:, 3].max() > 0.49  # every face of the hull is that far out


def test_pieces_that_lie_in_each_other_do_not_collide_at_birth() -> None:
    """An L and the block in its corner: the hull of the L would cover half of the block."""
    import manifold3d

    corner = manifold3d.Manifold.cube([2, 2, 1]) - manifold3d.Manifold.cube([1.6, 1.6, 1]).translate([0.4, 0.4, 0])
    raw = corner.to_mesh()
    letter = Mesh(np.asarray(raw.vert_properties, float)[:, :3], np.asarray(raw.tri_verts, np.int64))
    (parts,) = fragment_hulls([letter])
    assert len(parts.points) > 1
    assert parts.excess < 0.2
    inside = np.random.default_rng(0).uniform([0.5, 0.5, 0], [1.9, 1.9, 1], (2000, 3))
    covered = np.zeros(len(inside), bool)
    for points in parts.points:
        covered |= Delaunay(points).find_simplex(inside) >= 0
    assert covered.mean() < 0.15


def test_a_hull_is_that_of_scipy_but_for_its_sag() -> None:
    rng = np.random.default_rng(1)
    for points in (rng.normal(size=(12, 3)), rng.uniform(size=(300, 3)), rng.integers(0, 4, (200, 3)).astype(float)):
        found = quickhull(points, 1e-6)
        assert volume(found) == pytest.approx(ConvexHull(points).volume, rel=1e-4)
        exact = ConvexHull(corners(quickhull(points, 0.05))).equations
        assert (points @ exact[:, :3].T + exact[:, 3]).max() < 0.05 + 1e-4


@pytest.mark.parametrize("flat", [(1, 1, 0), (1, 0, 0), (0, 0, 0)])
def test_what_is_flat_has_a_solid_hull(flat: tuple[float, float, float]) -> None:
    points = np.random.default_rng(2).uniform(-1, 1, (40, 3)) * flat
    found = quickhull(points, 0.004)
    sides = np.ptp(corners(found), axis=0)
    assert volume(found) == pytest.approx(np.prod(sides))
    assert sides.min() == pytest.approx(0.004)


def test_a_cut_solid_keeps_its_volume() -> None:
    mesh = builtin("mug").mesh
    normal = np.array([0.6, 0.0, 0.8])
    below, above, rim = clip(mesh.triangles.copy(), np.ones(len(mesh.faces), bool), normal, 0.1)
    assert volume(below[0]) + volume(above[0]) == pytest.approx(mesh.volume)
    np.testing.assert_allclose(rim @ normal, 0.1, atol=1e-12)
    assert (below[0][below[1]] @ normal).max() < 0.1 + 1e-9


def _wavy_halves() -> list[Mesh]:
    """A block in two, the one's wave in the other's trough: their hulls overlap by a tenth of it."""
    x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21), indexing="ij")
    wave = 0.5 + 0.05 * np.sin(4 * np.pi * x)
    return [_slab(x, y, 0 * x, wave), _slab(x, y, wave, 0 * x + 1)]


def _slab(x: np.ndarray, y: np.ndarray, low: np.ndarray, high: np.ndarray) -> Mesh:
    """What lies between two height fields."""
    n = len(x)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    top = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    rim = np.concatenate([index[:, 0], index[-1, 1:], index[-2::-1, -1], index[0, -2:0:-1]])
    after = np.roll(rim, -1)
    side = np.concatenate([np.stack([rim, after, after + n * n], -1), np.stack([rim, after + n * n, rim + n * n], -1)])
    points = np.concatenate([np.stack([x, y, z], -1).reshape(-1, 3) for z in (low, high)])
    return Mesh(points, np.concatenate([top[:, ::-1], top + n * n, side]))


def test_hulls_of_neighbours_do_not_overlap() -> None:
    halves = _wavy_halves()
    assert sum(half.volume for half in halves) == pytest.approx(1)
    assert np.ptp(halves[0].vertices[:, 2]) + np.ptp(halves[1].vertices[:, 2]) > 1.09
    one, two = fragment_hulls(halves)
    for first in one.points:
        for second in two.points:
            solids = quickhull(first, 1e-4), quickhull(second, 1e-4)
            plane = np.array([0, 0, 0, 0, np.inf])
            least_overlap_plane(face_planes(solids[0]), second, plane)
            least_overlap_plane(face_planes(solids[1]), first, plane)
            assert plane[4] < 1e-3
    for hulls in (one, two):
        assert abs(hulls.excess) < FRAGMENT_EXCESS


@pytest.mark.parametrize(("name", "blur"), [("pot", 0.0), ("plate", 1.0), ("chair", 0.0)])
def test_no_hull_is_thin_however_thin_the_triangles_of_its_fragment_are(name: str, blur: float) -> None:
    """Noise leaves slivers of 1e-9 voxels in the fragments; an engine gets hulls of a millimetre at least."""
    shape, grid, rng = builtin(name), Grid(32), np.random.default_rng(0)
    noise = [gaussian_filter(n, blur) for n in rng.normal(size=(5, *grid.shape))]
    labels = (1 + np.argmax(noise, axis=0)) * (signed_distance(shape.mesh, grid) > 0)
    distance = rng.uniform(0, grid.spacing, grid.shape).astype(np.float32)
    fragments = cut(shape, FracturePattern(grid, labels, distance), density=1000.0)
    hulls = [points for found in fragment_hulls([piece.mesh for piece in fragments]) for points in found.points]
    assert len(hulls) > 100
    assert min(_width(points) for points in hulls) > THIN


def _width(points: np.ndarray) -> float:
    """Least distance of a face from the point across it [m]."""
    sides = ConvexHull(points).equations
    return float((-(sides[:, :3] @ points.T + sides[:, 3:])).max(axis=1).min())
