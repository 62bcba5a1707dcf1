"""The shapes that come with the program."""

import numpy as np
import pytest

from deepfracture.geometry import BUILTIN, builtin, closest_points, mesh_defects, signed_distance_points
from deepfracture.types import BadInput

GENUS = {"mug": 1, "letter_a": 1, "chair": 1}
MADE = [name for name in BUILTIN if name != "bunny"]


@pytest.mark.parametrize("name", MADE)
def test_closed_one_body_right_genus_and_normalised(name):
    shape = builtin(name)
    mesh = shape.mesh
    found = mesh_defects(mesh)
    assert found.closed and found.shells == 1
    assert len(mesh.vertices) - len(mesh.faces) // 2 == 2 - 2 * GENUS.get(name, 0)
    assert mesh.volume > 0
    low, high = mesh.bounds
    assert (high - low).max() == pytest.approx(2)
    np.testing.assert_allclose(low, -high, atol=1e-12)
    assert 1000 <= len(mesh.faces) <= 20_000


@pytest.mark.parametrize("name", MADE)
def test_walls_span_five_voxels_at_64(name):
    mesh = builtin(name).mesh
    normals = mesh.area_vectors / np.linalg.norm(mesh.area_vectors, axis=1, keepdims=True)
    below = mesh.triangles.mean(axis=1) - 0.155 * normals
    # Only faces at the tips of sharp edges may look through them.
    assert (signed_distance_points(mesh, below) > 0).mean() > 0.98


@pytest.mark.parametrize("name", MADE)
def test_few_slivers(name):
    mesh = builtin(name).mesh
    sides = mesh.triangles - np.roll(mesh.triangles, 1, axis=1)
    quality = 4 * np.sqrt(3) * np.linalg.norm(mesh.area_vectors, axis=1) / (sides**2).sum(axis=(1, 2))
    assert np.quantile(quality, 0.01) > 0.6


def test_the_pot_is_open_hollow_and_stands_flat():
    mesh = builtin("pot").mesh
    axis = np.array([[0.0, 0.0, z] for z in (-0.97, -0.9, 0.0, 0.97)])
    assert list(signed_distance_points(mesh, axis) > 0) == [True, True, False, False]
    sole = np.isclose(mesh.vertices[:, 2], -1.0)
    assert np.hypot(*mesh.vertices[sole, :2].T).max() > 0.3


def test_the_pot_has_an_even_wall():
    mesh = builtin("pot").mesh
    radius = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    belly = np.abs(mesh.vertices[:, 2]) < 0.2
    inner, outer = belly & (radius < 0.65), belly & (radius > 0.65)
    middle = mesh.vertices[inner]
    far = np.array([np.linalg.norm(mesh.vertices[outer] - p, axis=1).min() for p in middle[::20]])
    assert far.min() > 0.16 and far.max() < 0.2
    assert closest_points(mesh, [[0.0, 0.0, 0.0]]).distance[0] > 0.4


def test_the_bar_is_two_by_four_tenths():
    mesh = builtin("bar").mesh
    np.testing.assert_allclose(mesh.bounds, [[-1, -0.2, -0.2], [1, 0.2, 0.2]])
    assert mesh.volume == pytest.approx(0.32)


def test_shapes_stand_upright():
    # The chair's back rises above its seat: more material low than high, but reaching the top.
    chair = builtin("chair").mesh
    assert np.ptp(chair.vertices[:, 2]) == pytest.approx(2)
    bowl = builtin("bowl").mesh
    assert signed_distance_points(bowl, [[0, 0, bowl.bounds[1, 2] - 0.05]])[0] < 0


@pytest.mark.parametrize("name", ["A", "letter-a", "Letter A", "letter_a"])
def test_other_names_of_the_letter(name):
    assert builtin(name).name == "letter_a"


def test_unknown_names_list_the_known_ones():
    with pytest.raises(BadInput, match=r"'vase'.*pot, mug, bowl"):
        builtin("vase")


def test_the_bunny_stands_on_its_feet():
    shape = builtin("bunny")
    assert mesh_defects(shape.mesh).closed and len(shape.mesh.faces) == 902
    heights = shape.mesh.vertices[:, 2]
    # Ears are thin and up, feet are down: the middle of mass is below the middle of the box.
    assert np.median(heights) < 0.2
