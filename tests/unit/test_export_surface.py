"""Normals are smooth where a surface is smooth and split where it creases."""

import numpy as np
import trimesh

from deepfracture.export.surface import surfaces
from deepfracture.types import Mesh


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
