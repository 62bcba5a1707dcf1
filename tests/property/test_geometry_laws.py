"""Laws of normalisation, distance and mass that hold for any solid."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from deepfracture.geometry import (
    check_solid,
    mass_properties,
    normalise,
    signed_distance_lattice,
    signed_distance_points,
)
from deepfracture.geometry.orient import orient
from deepfracture.geometry.topology import compact
from deepfracture.types import Mesh

seeds = st.integers(0, 2**32 - 1)


def hull(seed, count=20):
    """A random convex solid and its half spaces."""
    points = np.random.default_rng(seed).normal(size=(count, 3))
    made = ConvexHull(points)
    return check_solid(orient(compact(points, made.simplices.astype(np.int64))), "hull"), made.equations


@settings(max_examples=25, deadline=None)
@given(seeds, st.floats(1e-4, 1e4), st.floats(-1e3, 1e3))
def test_normalise_and_back(seed, scale, shift):
    mesh = hull(seed)[0].moved(scale, (shift, -shift, 2 * shift))
    shape = normalise(mesh, "hull")
    size = np.ptp(shape.mesh.bounds, axis=0)
    np.testing.assert_allclose(size.max(), 2, rtol=1e-9)
    np.testing.assert_allclose(shape.mesh.bounds.mean(axis=0), 0, atol=1e-9 * (1 + abs(shift) / scale))
    np.testing.assert_allclose(shape.to_user(shape.mesh.vertices), mesh.vertices, rtol=1e-9, atol=1e-9 * scale)


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_sign_and_size_of_the_distance_to_convex_hulls(seed):
    mesh, planes = hull(seed)
    points = np.random.default_rng(seed + 1).uniform(-2, 2, (200, 3))
    heights = points @ planes[:, :3].T + planes[:, 3]
    inside = heights.max(axis=1) < 0
    distance = signed_distance_points(mesh, points)
    assert ((distance > 0) == inside).all()
    # Inside a convex body the nearest point lies on the nearest plane.
    np.testing.assert_allclose(distance[inside], -heights.max(axis=1)[inside], atol=1e-9)
    assert (-distance[~inside] >= heights.max(axis=1)[~inside] - 1e-9).all()


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_rays_through_vertices_and_edges_of_integer_solids(seed):
    # Vertices on the lattice itself: every column of it meets vertices, edges and upright faces.
    points = np.random.default_rng(seed).integers(-3, 4, (12, 3)).astype(float)
    points = np.concatenate([points, 4 * np.vstack([np.eye(3), -np.eye(3)])])
    made = ConvexHull(points)
    mesh = check_solid(orient(compact(points, made.simplices.astype(np.int64))), "hull")
    values = signed_distance_lattice(mesh, (-5, -5, -5), 1.0, (11, 11, 11))
    axis = np.arange(-5, 6)
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    heights = (lattice @ made.equations[:, :3].T + made.equations[:, 3]).max(axis=-1)
    assert (values[heights < -1e-9] > 0).all()
    assert (values[heights > 1e-9] < 0).all()


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0.1, 10))
def test_mass_scales_and_inertia_is_that_of_a_body(seed, scale):
    mesh, _ = hull(seed)
    one, many = mass_properties(mesh, 2.0), mass_properties(mesh.moved(scale, (5, 6, 7)), 2.0)
    np.testing.assert_allclose(many.mass, one.mass * scale**3, rtol=1e-9)
    np.testing.assert_allclose(many.inertia, one.inertia * scale**5, rtol=1e-6, atol=1e-9 * scale**5)
    moments = np.linalg.eigvalsh(one.inertia)
    assert moments[0] > 0 and moments[2] <= moments[0] + moments[1] + 1e-12


def test_flipping_any_faces_is_undone():
    mesh, _ = hull(3)
    flip = np.random.default_rng(0).random(len(mesh.faces)) < 0.5
    mixed = Mesh(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces))
    np.testing.assert_allclose(check_solid(mixed, "mixed").volume, mesh.volume)
