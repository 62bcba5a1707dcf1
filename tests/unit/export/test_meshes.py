"""Fragments come back closed, in the user's coordinates, and whole folders or none."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from deepfracture.export import write_fragments
from deepfracture.geometry import load_shape, mesh_defects
from deepfracture.runtime.files import atomic_file, atomic_folder
from deepfracture.types import Finish, Shape

tools = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "recordings.py"))
painted = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "painted.py"))


@pytest.fixture
def shape():
    return Shape("octahedron", tools["octahedron"](), scale=10.0, centre=np.array([1.0, 2.0, 3.0]))


def test_fragments_are_closed_and_in_user_coordinates(shape, tmp_path):
    pieces = tools["halves"]()
    paths = write_fragments(pieces, shape, tmp_path / "pieces")
    assert [path.name for path in paths] == ["fragment_000.ply", "fragment_001.ply"]
    read = [trimesh.load(path) for path in paths]
    assert all(mesh.is_watertight for mesh in read)
    assert np.isclose(sum(mesh.volume for mesh in read), 1000 * shape.mesh.volume)
    assert np.allclose(read[0].bounds, [[1, -8, -7], [11, 12, 13]])


def test_crack_faces_differ_in_colour(shape, tmp_path):
    path = write_fragments(tools["halves"](), shape, tmp_path / "pieces")[0]
    colours = trimesh.load(path).visual.face_colors
    assert len(np.unique(colours[:4], axis=0)) == len(np.unique(colours[4:], axis=0)) == 1
    assert (colours[0] != colours[4]).any()


def test_a_new_folder_replaces_the_old_one(shape, tmp_path):
    folder = tmp_path / "pieces"
    folder.mkdir()
    (folder / "fragment_099.ply").write_text("of an earlier run")
    write_fragments(tools["halves"](), shape, folder)
    assert sorted(p.name for p in folder.iterdir()) == ["fragment_000.ply", "fragment_001.ply"]
    assert [p.name for p in tmp_path.iterdir()] == ["pieces"]


def test_a_failure_leaves_what_was_there(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "kept").write_text("old")
    with pytest.raises(RuntimeError), atomic_file(tmp_path / "a.txt") as temporary:
        temporary.write_text("half")
        raise RuntimeError
    with pytest.raises(RuntimeError), atomic_folder(tmp_path / "d") as temporary:
        (temporary / "new").write_text("half")
        raise RuntimeError
    assert (tmp_path / "a.txt").read_text() == "old"
    assert [p.name for p in (tmp_path / "d").iterdir()] == ["kept"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt", "d"]


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cube")
    shape, fragments = painted["broken_cube"](folder)
    shape = replace(shape, scale=10.0, centre=np.array([1.0, 2.0, 3.0]))
    return shape, fragments, write_fragments(fragments, shape, folder / "fragments")


def test_painted_fragments_come_as_obj_too_with_their_materials(cube):
    """Each is read back by our own reader: closed, glazed where it was, stone inside."""
    shape, fragments, paths = cube
    texture = shape.appearance.finishes[0].texture
    for piece, path in zip(fragments, paths, strict=True):
        read = load_shape(str(path.with_suffix(".obj")))
        assert mesh_defects(read.mesh).closed and len(read.mesh.faces) == len(piece.mesh.faces)
        names = [finish.name for finish in read.appearance.finishes]
        assert set(names) <= {"glaze", "wax", "inner"} and "inner" in names
        finish = np.array(names)[read.appearance.finish]
        assert (finish == "inner").sum() == (piece.source < 0).sum()
        for each in read.appearance.finishes:
            assert (each.texture == texture) == (each.name == "glaze")
        outer = finish != "inner"
        body = (read.to_user(read.mesh.triangles[outer]) - shape.centre) / shape.scale
        normals = read.appearance.normals[outer].reshape(-1, 3)
        want = painted["expected_uv"](body.reshape(-1, 3), normals)
        assert np.abs(read.appearance.uv[outer].reshape(-1, 2) - want).max() < 1e-5
        assert np.abs(np.abs(normals).max(axis=1) - 1).max() < 1e-5


def test_closed_ply_shows_the_paint_by_face(cube):
    shape, fragments, paths = cube
    # The picture's upper half is turquoise, its lower half green; wax is red.
    for piece, path in zip(fragments, paths, strict=True):
        mesh = trimesh.load(path, process=False)
        assert mesh.is_watertight
        colours = mesh.visual.face_colors[:, :3].astype(int)
        outer = piece.source >= 0
        across_x = shape.appearance.finish[piece.source] == 1
        assert (colours[~outer] == (232, 186, 150)).all()
        assert (colours[outer & across_x] == (255, 0, 0)).all()
        glazed = outer & ~across_x
        upper = painted["expected_uv"](
            piece.mesh.triangles[glazed].mean(axis=1), shape.mesh.area_vectors[piece.source[glazed]]
        )[:, 1]
        want = np.where(upper[:, None] > 0.5, (0, 200, 200), (0, 200, 0))
        assert (colours[glazed] == want).all()


def test_materials_without_usable_names_get_some(cube, tmp_path):
    shape, fragments, _ = cube
    finishes = (Finish("inner", (1, 2, 3)), Finish("bright  red\nnewmtl evil"))
    odd = replace(shape, appearance=replace(shape.appearance, finishes=finishes))
    path = write_fragments(fragments, odd, tmp_path / "fragments")[0]
    known = [line for line in (path.parent / "fragments.mtl").read_text().splitlines() if line.startswith("newmtl")]
    assert known == ["newmtl inner_0", "newmtl bright_red_newmtl_evil", "newmtl inner"]
    used = {f.name for f in load_shape(str(path.with_suffix(".obj"))).appearance.finishes}
    assert used <= {"inner_0", "bright_red_newmtl_evil", "inner"} and len(used) > 1
