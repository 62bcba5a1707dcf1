"""A sequence of meshes shows what the recording says, frame by frame."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from deepfracture.export import write_sequence
from deepfracture.geometry import mesh_defects
from deepfracture.geometry.wavefront import read_obj
from deepfracture.recording.motion import pose
from deepfracture.types import BadInput, Mesh, Rigid

TOOLS = Path(__file__).parents[2] / "tools"
tools = runpy.run_path(str(TOOLS / "recordings.py"))
painted = runpy.run_path(str(TOOLS / "painted.py"))
HIT, RATE = tools["HIT"], tools["RATE"]
USER = np.array([[0, -10, 0, 5], [10, 0, 0, 6], [0, 0, 10, 7], [0, 0, 0, 1]], float)


def objects(path):
    """Vertices and triangles (vertex indices) of each object of an OBJ file, read independently of the writer."""
    found, places, name = {}, [], ""
    for line in path.read_text().splitlines():
        key, *words = line.split()
        if key == "o":
            name = words[0]
            found[name] = []
        elif key == "v":
            places.append([float(w) for w in words])
        elif key == "f":
            corners = [int(w.split("/")[0]) for w in words]
            assert all(corner < 0 for corner in corners)
            found[name].append([len(places) + corner for corner in corners])
    return {name: (np.array(places), np.array(faces)) for name, faces in found.items()}


def recorded(track, frame):
    matrix = USER @ pose(track, frame)
    return track.mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]


def colours(read):
    """Of the vertices of a PLY file."""
    raw = read.metadata["_ply_raw"]["vertex"]["data"]
    return set(zip(*(raw[name].ravel().tolist() for name in ("red", "green", "blue")), strict=True))


@pytest.fixture
def recording():
    return tools["broken_octahedron"](USER)


def test_every_body_is_where_it_was_and_only_while_it_was(recording, tmp_path):
    paths = write_sequence(recording, tmp_path / "frames", kind="obj", rate=RATE)
    assert [p.name for p in paths] == [f"frame_{k:04d}.obj" for k in range(61)] and all(p.is_file() for p in paths)
    _, whole, ball, *halves = recording.tracks
    for frame in (0, HIT - 1, HIT, 40, 60):
        seen = objects(paths[frame])
        expected = {"ball": ball} | (
            {"octahedron": whole} if frame < HIT else {f"fragment_{k:03d}": half for k, half in enumerate(halves)}
        )
        assert seen.keys() == expected.keys()
        for name, track in expected.items():
            places, faces = seen[name]
            there = recorded(track, frame)[track.mesh.faces]
            apart = np.abs(np.sort(places[faces].mean(axis=1), axis=0) - np.sort(there.mean(axis=1), axis=0))
            assert apart.max() < 1e-5
            used, packed = np.unique(faces, return_inverse=True)
            assert mesh_defects(Mesh(places[used], packed.reshape(-1, 3))).closed


def test_between_the_recorded_frames_the_centre_of_mass_flies_straight(recording, tmp_path):
    still = Rigid(1.0, np.array([0.25, 0, 0]), np.eye(3), np.zeros((46, 3)), np.zeros((46, 3)))
    tracks = (*recording.tracks[:-1], replace(recording.tracks[-1], rigid=still))
    paths = write_sequence(replace(recording, tracks=tracks), tmp_path / "frames", rate=2 * RATE)
    assert len(paths) == 121
    track = tracks[-1]
    ends = [pose(track, k)[:3, :3] @ still.centre + pose(track, k)[:3, 3] for k in (20, 21)]
    places, faces = objects(paths[41])["fragment_001"]
    shift = track.mesh.vertices[np.unique(track.mesh.faces)].mean(axis=0) - still.centre
    middle = places[np.unique(faces)].mean(axis=0)
    centre = USER[:3, :3] @ np.mean(ends, axis=0) + USER[:3, 3]
    assert np.linalg.norm(middle - centre) == pytest.approx(10 * np.linalg.norm(shift), abs=1e-4)


def test_a_slower_rate_keeps_the_time(recording, tmp_path):
    paths = write_sequence(recording, tmp_path / "frames", rate=24)
    assert len(paths) == 49  # two seconds
    places, faces = objects(paths[-1])["ball"]
    there = recorded(recording.tracks[2], 60)
    assert np.abs(np.ptp(places[np.unique(faces)], axis=0) - np.ptp(there, axis=0)).max() < 1e-5
    assert np.abs(places[np.unique(faces)].mean(axis=0) - there.mean(axis=0)).max() < 1e-5
    assert "octahedron" in objects(paths[11]) and "fragment_000" in objects(paths[12])  # 0.5 s: the break


def test_ply_holds_the_same(recording, tmp_path):
    paths = write_sequence(recording, tmp_path / "frames", kind="ply", rate=RATE)
    assert len(paths) == 61
    read = trimesh.load(paths[40], process=False)
    assert len(read.faces) == 8 + 2 * 6
    volume = sum(mesh.volume for mesh in (tools["octahedron"](), recording.tracks[2].mesh)) * 1000
    assert trimesh.Trimesh(read.vertices, read.faces).volume == pytest.approx(volume, rel=1e-4)
    header = paths[40].read_bytes().split(b"end_header")[0].decode()
    assert "comment body 2 fragment_000\ncomment body 3 fragment_001\n" in header
    assert len(colours(read)) == 3  # ball, outside and inside
    assert np.allclose(np.einsum("ni,ni->n", read.vertex_normals, read.vertex_normals), 1)


def test_looks_come_along(tmp_path):
    shape, fragments = painted["broken_cube"](tmp_path)
    recording = painted["filmed"](shape, fragments)
    paths = write_sequence(recording, tmp_path / "obj", kind="obj", rate=30)
    soup = read_obj(paths[2])
    look = soup.appearance()
    assert {finish.name for finish in look.finishes} == {"glaze", "wax", "inner"}
    assert look.finishes[[f.name for f in look.finishes].index("glaze")].texture is not None
    glazed = np.flatnonzero(look.finish == [f.name for f in look.finishes].index("glaze"))
    corners = soup.vertices[soup.faces[glazed]]
    moved = np.abs(corners).max()
    assert moved == pytest.approx(1, abs=1e-5)  # the third frame: fragments are where they broke
    expected = painted["expected_uv"](corners.reshape(-1, 3), look.normals[glazed].reshape(-1, 3))
    assert np.abs(look.uv[glazed].reshape(-1, 2) - expected).max() < 1e-4
    read = trimesh.load(write_sequence(recording, tmp_path / "ply", kind="ply", rate=30)[2], process=False)
    assert {(255, 0, 0), (0, 200, 0), (0, 200, 200)} <= colours(read)


def test_bad_values_get_one_line(recording, tmp_path):
    with pytest.raises(BadInput, match="kind must be obj or ply"):
        write_sequence(recording, tmp_path / "frames", kind="stl")
    with pytest.raises(BadInput, match="rate must be positive"):
        write_sequence(recording, tmp_path / "frames", rate=0)
    assert not list(tmp_path.iterdir())
