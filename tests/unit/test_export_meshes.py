"""Fragments come back closed, in the user's coordinates, and whole folders or none."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import trimesh

from deepfracture.export import write_fragments
from deepfracture.export.files import replacing, replacing_folder
from deepfracture.types import Shape

tools = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "recordings.py"))


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
    with pytest.raises(RuntimeError), replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("half")
        raise RuntimeError
    with pytest.raises(RuntimeError), replacing_folder(tmp_path / "d") as temporary:
        (temporary / "new").write_text("half")
        raise RuntimeError
    assert (tmp_path / "a.txt").read_text() == "old"
    assert [p.name for p in (tmp_path / "d").iterdir()] == ["kept"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt", "d"]
