"""What runs between the voxels cannot be divided, and says so."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from deepfracture.api import hit
from deepfracture.breakers import BreakerOptions, make_breaker
from deepfracture.fracture import material, prepare_body
from deepfracture.geometry import builtin, signed_distance
from deepfracture.types import BadInput, Grid, Mesh, Shape


@pytest.mark.parametrize("name", ["voronoi", "cvd"])
def test_a_shape_thinner_than_a_voxel_is_refused_and_a_splinter_stays_whole(name: str) -> None:
    bar = builtin("bar").mesh
    shape = Shape("needle", Mesh(bar.vertices * [1, 0.01, 0.01], bar.faces))
    blow = hit(shape, (0, 0, 0.1), (0, 0, -1), impulse=500, speed=10)
    breaker = make_breaker(name, shape, material("plaster"), BreakerOptions(resolution=32))
    with pytest.raises(BadInput, match=r"needle: thinner than a voxel of 0\.0625 m"):
        breaker(shape, blow, np.random.default_rng(0))
    splinter = replace(shape, whole=builtin("pot"))
    assert breaker(splinter, blow, np.random.default_rng(0)) is None


def test_a_skin_that_a_few_voxel_centres_happen_to_lie_in_is_refused(voxels: int = 32) -> None:
    made = trimesh.creation.icosphere(3)
    ball = Mesh(made.vertices, made.faces)
    skin = Shape("skin", joined(ball, Mesh(ball.vertices * (1 - 1e-4), ball.faces[:, ::-1])))
    blow = hit(skin, (0, 0, 1), (0, 0, -1), impulse=3000, speed=20)
    assert (signed_distance(skin.mesh, Grid(voxels)) > 0).any()
    with pytest.raises(BadInput, match="skin: thinner than a voxel"):
        breaker = make_breaker("voronoi", skin, material("plaster"), BreakerOptions(resolution=voxels))
        breaker(skin, blow, np.random.default_rng(0))


def joined(one: Mesh, other: Mesh) -> Mesh:
    return Mesh(
        np.concatenate([one.vertices, other.vertices]), np.concatenate([one.faces, other.faces + len(one.vertices)])
    )


def test_the_simulator_refuses_what_is_thinner_than_its_cells_before_it_is_hit() -> None:
    bar = builtin("bar").mesh
    sheet = Shape("sheet", Mesh(bar.vertices * [1, 1, 1e-5], bar.faces))
    with pytest.raises(BadInput, match="sheet: thinner than a cell"):
        prepare_body(sheet, material("plaster"), Grid(32), elements=500, cache=False)
