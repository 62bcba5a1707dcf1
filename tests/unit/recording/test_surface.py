"""Normals are smooth where a surface is smooth and split where it creases."""

import numpy as np
import trimesh

from deepfracture.recording.surface import painted, surfaces
from deepfracture.types import Appearance, Finish, Mesh, Shape


def as_mesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(shape.vertices), np.array(shape.faces))


def test_a_sphere_keeps_its_vertices_and_gets_radial_normals():
    ball = as_mesh(trimesh.creation.icosphere(subdivisions=3))
    (surface,) = surfaces(ball, None)
    assert len(surface.vertices) == len(ball.vertices)
    assert np.einsum("ni,ni->n", surface.vertices, surface.normals).min() > 0.999


def test_a_box_gets_one_flat_normal_a_side():
    (surface,) = surfaces(as_mesh(trimesh.creation.box((1, 2, 3))), None)
    assert len(surface.vertices) == 24
    assert np.allclose(np.sort(np.abs(surface.normals), axis=1), [0, 0, 1])


def test_a_cone_is_smooth_around_and_sharp_at_its_base():
    cone = as_mesh(trimesh.creation.cone(1.0, 2.0, sections=32))
    (surface,) = surfaces(cone, None)
    base = surface.normals[:, 2] < -0.999
    assert base.sum() == 33  # the rim again, and its middle
    rim = ~base & (np.abs(np.hypot(*surface.vertices[:, :2].T) - 1) < 1e-6)
    assert rim.sum() == 32
    assert np.allclose(surface.normals[rim, 2], 1 / np.sqrt(5), atol=5e-3)


def test_triangles_and_their_order_survive_the_split():
    box = as_mesh(trimesh.creation.box())
    source = np.where(np.arange(12) < 5, -1, np.arange(12))
    outer, inner = surfaces(box, source)
    assert (outer.look, inner.look) == ("outer", "inner")
    assert np.allclose(outer.vertices[outer.faces], box.triangles[source >= 0])
    assert np.allclose(inner.vertices[inner.faces], box.triangles[source < 0])


def test_faces_without_area_keep_unit_normals():
    mesh = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], float), np.array([[0, 1, 2], [0, 1, 3]]))
    (surface,) = surfaces(mesh, None)
    assert np.allclose(np.linalg.norm(surface.normals, axis=1), 1)


def test_a_broken_surface_is_as_smooth_as_the_whole_was():
    """Also at the crack, where half of the faces around a vertex are gone; the crack itself stays sharp."""
    ball = as_mesh(trimesh.creation.icosphere(subdivisions=2))
    upper = ball.triangles[:, :, 2].mean(axis=1) > 0
    source = np.flatnonzero(upper)
    piece = Mesh(ball.vertices, ball.faces[upper])
    (alone,) = surfaces(piece, source)
    (surface,) = surfaces(piece, source, whole=Shape("ball", ball))
    radial = surface.vertices / np.linalg.norm(surface.vertices, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", surface.normals, radial).min() > 0.999
    assert np.einsum("ni,ni->n", alone.normals, alone.vertices).min() < 0.995
    assert len(surface.vertices) == len(np.unique(piece.faces))  # corners that agree share a vertex


def test_normals_of_the_file_win_over_creases():
    box = as_mesh(trimesh.creation.box())
    normals = box.triangles / np.linalg.norm(box.triangles, axis=2, keepdims=True)
    shape = Shape("box", box, appearance=Appearance(np.zeros(12, int), normals=normals))
    (surface,) = surfaces(box, None, whole=shape)
    assert len(surface.vertices) == 8
    assert np.allclose(surface.normals, surface.vertices / np.sqrt(0.75), atol=1e-6)
    assert painted(shape) is shape.appearance


def test_each_finish_is_a_surface_and_seams_are_split():
    box = as_mesh(trimesh.creation.box())
    uv = np.random.default_rng(0).random((12, 3, 2))
    finish = np.arange(12) % 2
    finishes = (Finish("glaze"), Finish("wax", (1, 2, 3)), Finish("not used"))
    shape = Shape("box", box, appearance=Appearance(finish, finishes, uv=uv))
    source = np.where(np.arange(12) < 4, -1, np.arange(12))
    glaze, wax, inner = surfaces(box, source, whole=shape)
    assert [s.name for s in (glaze, wax, inner)] == ["glaze", "wax", "inner"]
    assert [s.base for s in (glaze, wax, inner)] == [(189, 94, 61), (1, 2, 3), (232, 186, 150)]
    for surface, own in ((glaze, [4, 6, 8, 10]), (wax, [5, 7, 9, 11])):
        assert len(surface.vertices) == 12  # no two corners have the same coordinates
        assert np.allclose(surface.vertices[surface.faces], box.triangles[own])
        assert np.allclose(surface.uv[surface.faces], uv[own])
    assert np.allclose(inner.vertices[inner.faces], box.triangles[:4])
