"""Distances, mass properties and remeshing against closed forms and brute force."""

import numpy as np
import pytest

from deepfracture.geometry import (
    builtin,
    closest_points,
    mass_properties,
    mesh_defects,
    remesh,
    signed_distance,
    signed_distance_lattice,
    signed_distance_points,
)
from deepfracture.geometry.aabb_tree import offset_from_triangle
from deepfracture.geometry.isosurface import isosurface
from deepfracture.geometry.solids import box, revolve
from deepfracture.geometry.topology import split_pinches
from deepfracture.types import BadInput, Grid, Mesh

HALF = np.array([0.9, 0.5, 0.3])


def box_distance(points):
    """Signed distance to the box of half sides HALF, + inside."""
    q = np.abs(points) - HALF
    outside = np.linalg.norm(np.maximum(q, 0), axis=-1)
    return -(outside + np.minimum(q.max(axis=-1), 0))


def ball(length=0.05):
    angle = np.linspace(-np.pi / 2, np.pi / 2, 200)
    return revolve([np.column_stack([np.maximum(np.cos(angle), 0), np.sin(angle)])], length)


def brute_force(mesh, points):
    return np.array([min(np.linalg.norm(offset_from_triangle(*p, t)) for t in mesh.triangles) for p in points])


def test_distance_of_a_box_is_exact_with_faces_on_lattice_planes():
    mesh = box(2 * HALF, 0.2)
    # Rays along z run through edges and vertices of the triangulation here.
    step = 0.1
    values = signed_distance_lattice(mesh, (-1.2, -1.2, -1.2), step, (25, 25, 25))
    axis = -1.2 + step * np.arange(25)
    exact = box_distance(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1))
    np.testing.assert_allclose(values, exact, atol=1e-6)


def test_distance_of_a_ball_converges_to_the_sphere():
    grid = Grid(32)
    values = signed_distance(ball(0.1), grid)
    exact = 1 - np.linalg.norm(grid.centres(), axis=-1)
    coarse = np.abs(values - exact).max()
    assert coarse < 0.005
    assert np.abs(signed_distance(ball(0.05), grid) - exact).max() < coarse / 3  # second order


def test_lattice_points_and_brute_force_agree():
    mesh, grid = builtin("letter_a").mesh, Grid(32)
    index = np.random.default_rng(1).integers(0, 32, (40, 3))
    on_lattice = signed_distance(mesh, grid)[tuple(index.T)]
    at_points = signed_distance_points(mesh, grid.to_world(index))
    np.testing.assert_allclose(on_lattice, at_points, atol=1e-7)
    np.testing.assert_allclose(np.abs(at_points), brute_force(mesh, grid.to_world(index)), atol=1e-12)


def test_lattice_steps_may_differ_and_a_limit_cuts_off():
    mesh, step = box(2 * HALF, 0.2), np.array([0.2, 0.13, 0.07])
    values = signed_distance_lattice(mesh, (-1.5, -1, -1), step, (15, 16, 28), limit=0.25)
    index = np.stack(np.meshgrid(*map(np.arange, values.shape), indexing="ij"), axis=-1)
    exact = box_distance(index * step + [-1.5, -1, -1])
    np.testing.assert_allclose(values, np.clip(exact, -0.25, 0.25), atol=1e-6)


def test_distances_may_be_cut_off_outside_alone():
    mesh = ball(0.2)
    full = signed_distance_lattice(mesh, (-1.5, -1.5, -1.5), 0.1, (31, 31, 31))
    near = signed_distance_lattice(mesh, (-1.5, -1.5, -1.5), 0.1, (31, 31, 31), outside=0.15)
    assert (near == np.maximum(full, np.float32(-0.15))).all()
    both = signed_distance_lattice(mesh, (-1.5, -1.5, -1.5), 0.1, (31, 31, 31), limit=0.1, outside=0.15)
    assert (both == np.clip(full, np.float32(-0.1), np.float32(0.1))).all()


def test_volume_inside_matches_the_divergence_theorem():
    mesh, grid = builtin("base").mesh, Grid(32)
    # The share of each voxel inside, for a flat surface through it.
    share = np.clip(signed_distance(mesh, grid) / grid.spacing + 0.5, 0, 1)
    assert share.sum() * grid.spacing**3 == pytest.approx(mesh.volume, rel=0.005)


def test_overlapping_parts_are_inside_and_inward_shells_are_voids():
    one, small = box((2, 2, 2), 0.5), box((1, 1, 1), 0.5)
    n = len(one.vertices)
    both = Mesh(np.concatenate([one.vertices, small.vertices]), np.concatenate([one.faces, small.faces + n]))
    hollow = Mesh(both.vertices, np.concatenate([one.faces, small.faces[:, ::-1] + n]))
    middle = np.array([[0.01, 0.02, 0.03]])
    assert signed_distance_points(both, middle)[0] > 0
    assert signed_distance_points(hollow, middle)[0] < 0
    assert signed_distance_points(hollow, [[0.75, 0, 0]])[0] == pytest.approx(0.25)


def test_closest_lies_in_the_face_it_names():
    mesh = builtin("chair").mesh
    points = np.random.default_rng(2).uniform(-1.5, 1.5, (300, 3))
    found = closest_points(mesh, points)
    np.testing.assert_allclose(np.linalg.norm(points - found.points, axis=1), found.distance, atol=1e-12)
    for point, face in zip(found.points, found.faces, strict=True):
        assert np.linalg.norm(offset_from_triangle(*point, mesh.triangles[face])) < 1e-12


@pytest.mark.parametrize("height", [0.0, 1e-12, 1e-6])
def test_distance_to_slivers_and_triangles_without_area(height):
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0.4, height, 0]])
    assert np.linalg.norm(offset_from_triangle(0.7, 0.3, 0.4, corners)) == pytest.approx(0.5, abs=2e-6)
    assert np.linalg.norm(offset_from_triangle(-0.3, 0.0, 0.4, corners)) == pytest.approx(0.5)
    point = np.zeros((3, 3))
    assert np.linalg.norm(offset_from_triangle(0.0, 0.6, 0.8, point)) == pytest.approx(1)


def test_distance_to_a_triangle_flat_on_its_side_that_rounding_gives_an_area():
    a, b = (
        np.array([0.13997230620387197, 0.513059887425004, 0.4887891192256066]),
        np.array([0.16026251910904496, 0.4943416608899148, 0.44035849172965486]),
    )
    on_the_side = 0.14943838985233657, 0.5043271895987091, 0.4661945622750766
    assert np.linalg.norm(offset_from_triangle(*on_the_side, np.array([a, b, (a + b) / 2]))) < 1e-12


def test_bad_queries_say_what_is_wrong():
    mesh = box((1, 1, 1), 0.5)
    with pytest.raises(BadInput, match=r"shape \(n, 3\)"):
        closest_points(mesh, [[1, 2]])
    with pytest.raises(BadInput, match="spacing must be positive"):
        signed_distance_lattice(mesh, (0, 0, 0), 0.0, (2, 2, 2))
    with pytest.raises(BadInput, match="no triangles"):
        closest_points(Mesh(np.zeros((3, 3)), np.zeros((0, 3), int)), [[0, 0, 0]])


def test_mass_of_a_box_far_away():
    size, density, offset_ = np.array([2.0, 0.4, 0.6]), 2700.0, np.array([500.0, -3.0, 40.0])
    props = mass_properties(box(size, 0.2).moved(1.0, offset_), density)
    mass = density * size.prod()
    inertia = mass / 12 * np.diag((size**2).sum() - size**2)
    assert props.mass == pytest.approx(mass)
    np.testing.assert_allclose(props.centre, offset_, atol=1e-9)
    np.testing.assert_allclose(props.inertia, inertia, atol=1e-6)


def test_inertia_turns_with_the_body_and_matches_the_ball():
    mesh = builtin("mug").mesh
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    before, after = mass_properties(mesh, 1.0), mass_properties(Mesh(mesh.vertices @ turn.T, mesh.faces), 1.0)
    np.testing.assert_allclose(after.inertia, turn @ before.inertia @ turn.T, atol=1e-9)
    np.testing.assert_allclose(after.centre, turn @ before.centre, atol=1e-9)
    props = mass_properties(ball(0.05), 3.0)
    np.testing.assert_allclose(props.inertia, 0.4 * props.mass * np.eye(3), atol=0.005 * props.mass)


def test_mass_properties_refuse_what_has_no_mass():
    mesh = box((1, 1, 1), 0.5)
    with pytest.raises(BadInput, match="density"):
        mass_properties(mesh, 0.0)
    with pytest.raises(BadInput, match="face outward"):
        mass_properties(Mesh(mesh.vertices, mesh.faces[:, ::-1]), 1.0)


@pytest.mark.parametrize(("name", "triangles"), [("bar", 400), ("mug", 600), ("chair", 600)])
def test_remesh_is_closed_even_and_keeps_the_volume(name, triangles):
    mesh = builtin(name).mesh
    made = remesh(mesh, triangles)
    assert str(mesh_defects(made)) == ""
    assert euler(made) == euler(mesh)
    assert len(made.faces) == pytest.approx(triangles, rel=0.25)
    assert made.volume == pytest.approx(mesh.volume, rel=0.02)
    assert shape_quality(made).min() > 0.2


def test_remesh_refines_a_box_of_twelve_triangles_and_follows_thin_limbs():
    coarse = box((2, 0.4, 0.4), 9.0)
    assert len(coarse.faces) == 12
    made = remesh(coarse, 300)
    assert len(made.faces) == pytest.approx(300, rel=0.1)
    assert made.volume == pytest.approx(0.32, rel=0.02)
    # A rod thinner than a triangle: clusters go round it, and are parted.
    rod = box((2, 0.05, 0.05), 9.0)
    thin = remesh(rod, 300)
    assert mesh_defects(thin).closed and thin.volume == pytest.approx(rod.volume, rel=0.02)
    assert euler(thin) == 2 and 300 <= len(thin.faces) <= 600
    assert np.quantile(shape_quality(thin), 0.05) > 0.2
    with pytest.raises(BadInput, match=r"30 triangles are too few .* ask for"):
        remesh(rod, 30)


def test_remesh_refuses_open_meshes_and_silly_counts():
    mesh = box((1, 1, 1), 0.5)
    with pytest.raises(BadInput, match="1 open shell, 3 boundary edges"):
        remesh(Mesh(mesh.vertices, mesh.faces[1:]), 100)
    with pytest.raises(BadInput, match="20 or more"):
        remesh(mesh, 3)


def test_remesh_is_the_same_every_time():
    mesh = builtin("letter_a").mesh
    one, two = remesh(mesh, 300), remesh(mesh, 300)
    assert one.vertices.tobytes() == two.vertices.tobytes() and one.faces.tobytes() == two.faces.tobytes()


def test_isosurfaces_are_closed_whatever_the_values():
    axis = np.linspace(-1.5, 1.5, 31)
    away = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1), axis=-1).astype(np.float32)
    ball = isosurface(away - 1, np.full(3, -1.5), 0.1)
    assert str(mesh_defects(ball)) == "" and euler(ball) == 2
    assert ball.volume == pytest.approx(4 / 3 * np.pi, rel=0.01)
    assert np.linalg.norm(ball.vertices, axis=1) == pytest.approx(
        1, abs=0.009
    )  # crossings keep clear of lattice points
    noise = np.random.default_rng(0).normal(size=(9, 9, 9)).astype(np.float32)
    noise[4, 4, 4] = 0
    wild = isosurface(np.pad(noise, 1, constant_values=1), np.zeros(3), 1.0)
    assert str(mesh_defects(wild)) == "" and len(split_pinches(wild).vertices) == len(wild.vertices)
    with pytest.raises(BadInput, match="positive all round"):
        isosurface(noise - 9, np.zeros(3), 1.0)


def euler(mesh):
    return len(mesh.vertices) - len(mesh.faces) // 2


def shape_quality(mesh):
    """1 for equilateral triangles, 0 for slivers."""
    sides = mesh.triangles - np.roll(mesh.triangles, 1, axis=1)
    return 4 * np.sqrt(3) * np.linalg.norm(mesh.area_vectors, axis=1) / (sides**2).sum(axis=(1, 2))
