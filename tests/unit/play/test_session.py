"""One player's world, its shapes and uploads; no browser."""

import runpy
import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from deepfracture.cli.main import main
from deepfracture.fracture import material
from deepfracture.geometry import load_shape
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.play.breaker_cache import BreakerCache
from deepfracture.play.launch import Obstacle, launch
from deepfracture.play.library import Library
from deepfracture.play.readout import Timing, breaker_html, readout_html
from deepfracture.play.saving import make_file
from deepfracture.play.scene_nodes import plain_surfaces
from deepfracture.play.session import MAX_BALLS, Session, Setup, Shot
from deepfracture.play.uploads import read_upload
from deepfracture.types import BadInput
from deepfracture.world import load_scene, simulate

CUBE = """v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1
f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"""
OPEN_CUBE = CUBE.replace("f 5 6 7 8\n", "")
snapper = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "snap.py"))["snapper"]
GLASS = Setup("voronoi", "glass")
FRONT = np.array([5.0, 0.3, 1.0])
"""Where the player stands."""


class Snapping(BreakerCache):
    """Whatever the breaker is called, things snap in two: quick, and of few pieces."""

    def breaker(self, entry, name, material):
        super().breaker(entry, name, material)  # complains of what cannot be
        return snapper(material)


@pytest.fixture(scope="module")
def library():
    return Library("bar")


@pytest.fixture(scope="module")
def breakers():
    return Snapping()


@pytest.fixture
def session(library, breakers):
    opened = Session(breakers, library.entry("bar"), GLASS)
    finish(opened)
    yield opened
    opened.close()


def finish(session, frames=240):
    for _ in range(frames):
        if not session.step():
            break


def aim(session, kind):
    """A ray from the player to the middle of the first such body."""
    pose = next(pose for pose in session.at(session.frames - 1) if pose.kind == kind)
    goal = pose.position + rotation_matrix(pose.quat_wxyz) @ pose.mesh.vertices.mean(axis=0)
    return FRONT, goal - FRONT


def test_a_ball_that_misses_breaks_nothing(session):
    assert session.shoot(FRONT, np.array([0.0, 1.0, 0.5]), Shot()) is not None
    finish(session)
    assert session.readout() is None
    assert [pose.kind for pose in session.at(session.frames - 1)] == ["shape", "ball"]


def test_a_hit_tells_its_physics_and_a_piece_breaks_again(session):
    assert session.shoot(*aim(session, "shape"), Shot(speed=16.0))
    finish(session)
    first = session.readout()
    assert first.body == "shape0" and first.fragments >= 2 and first.pieces == first.fragments
    assert first.stress > first.strength == material("glass").strength
    assert {"cut", "put in"} <= set(first.milliseconds)
    for _ in range(4):
        assert session.shoot(*aim(session, "fragment"), Shot(speed=30.0))
        finish(session)
        second = session.readout()
        if second is not None and second.fragments:
            break
    assert second.body.startswith("shape0.") and second.pieces > first.pieces


def test_a_weak_hit_leaves_it_whole_and_says_so(session):
    session.shoot(*aim(session, "shape"), Shot(radius=0.05, speed=1.0))
    finish(session)
    found = session.readout()
    assert found is not None and found.fragments == 0 and found.milliseconds == {}
    assert "did not break" in readout_html(found, Timing())


def test_a_reset_world_is_as_it_was_and_repeats_itself(session):
    start = session.at(0)[0].position
    ends = []
    for _ in range(2):
        session.reset()
        assert session.frames == 1 and np.array_equal(session.at(0)[0].position, start)
        finish(session)
        session.shoot(FRONT, np.array([-1.0, 0.0, -0.15]), Shot())
        finish(session)
        ends.append(np.concatenate([pose.position for pose in session.at(session.frames - 1)]))
    assert ends[0].tobytes() == ends[1].tobytes()


def test_a_setup_that_does_not_fit_leaves_the_world_alone(session, library):
    frames, before = session.frames, session.setup
    with pytest.raises(BadInput, match="learned"):
        session.reset(library.entry("bar"), replace(before, breaker="learned"))
    assert session.setup == before and session.frames == frames and session.at_rest
    with pytest.raises(BadInput, match="no material is called"):
        Setup("voronoi", "cheese")


def test_a_world_takes_so_many_balls_and_no_more(session):
    thrown = [session.shoot(FRONT, np.array([0.0, 1.0, 0.5]), Shot(radius=0.05)) for _ in range(MAX_BALLS + 1)]
    assert all(thrown[:-1]) and thrown[-1] is None
    assert f"{MAX_BALLS} balls" in session.full


def test_what_was_played_is_replayed_by_the_scene_that_is_saved(tmp_path):
    session = Session(BreakerCache(), Library("bar").entry("bar"), replace(GLASS, seed=5))
    session.shoot(*aim(session, "shape"), Shot(radius=0.1, speed=6.0))
    finish(session, 15)
    assert session.readout().fragments > 1
    name, content = make_file("scene", session.recording(), session.scene(), session.entry)
    _, glb = make_file("glb", session.recording(), session.scene(), session.entry)
    session.close()
    assert name == "scene.toml"
    (tmp_path / name).write_bytes(content)
    main(["shatter", "--scene", str(tmp_path / name), "--out", str(tmp_path / "out"), "--no-film"])
    assert (tmp_path / "out" / "animation.glb").read_bytes() == glb


def test_a_ball_starts_outside_and_flies_along_the_ray():
    shape = load_shape("bar")
    still = Obstacle(shape.mesh, np.array([0.0, 0.0, 1.0]), np.eye(3))
    origin = np.array([4.0, 0.5, 2.5])
    direction = (np.array([0.0, 0.0, 1.0]) - origin) / np.linalg.norm(np.array([0.0, 0.0, 1.0]) - origin)
    ball = launch(origin, direction, radius=0.2, speed=14.0, obstacles=[still], floor=0.0)
    start, velocity = np.array(ball.position), np.array(ball.velocity)
    along = (start - origin) @ direction
    assert np.allclose(start, origin + along * direction)  # on the ray
    assert velocity @ direction > 0.999 * np.linalg.norm(velocity)
    centres = start + np.linspace(0, 1.5, 200)[:, None] * direction
    gap = np.array([np.linalg.norm(shape.mesh.vertices + still.position - c, axis=1).min() for c in centres])
    assert gap[0] > 0.2 and gap.min() < 0.35  # free at the start, and it gets there
    assert launch(np.array([0.0, 0.0, 1.1]), direction, radius=0.2, speed=9.0, obstacles=[still], floor=0.0) is None


def test_a_slow_ball_meets_the_ray_in_spite_of_gravity(session):
    """At 2 m/s it would fall by its own size on the way, were it not thrown a little upwards."""
    origin, towards = aim(session, "shape")
    session.shoot(origin, towards, Shot(radius=0.1, speed=2.0))
    finish(session, 30)
    assert session.readout() is not None


def test_learned_is_offered_where_there_is_a_model(library):
    assert library.entry("bar").breakers == ("physical", "voronoi", "cvd")
    assert library.entry("pot").breakers[0] == "learned"
    assert library.first == "bar" and library.labels[0] == "bar" and "pot" in library.labels
    with pytest.raises(BadInput, match="unknown; choose one of"):
        library.entry("../../etc/passwd")
    assert "deepfracture train" in breaker_html(library.entry("bar"), "physical", "plaster")


def test_an_upload_is_read_mended_or_refused_in_one_line(tmp_path):
    good = read_upload(CUBE.encode(), "cube.obj", tmp_path / "a", limit=10_000)
    assert good.label == "cube.obj" and not good.repair and good.shape.mesh.volume == pytest.approx(8)
    mended = read_upload(OPEN_CUBE.encode(), "C:\\stuff\\open <b>.obj", tmp_path / "b", limit=10_000)
    assert mended.repair and mended.label == "open _b_.obj" and mended.shape.mesh.volume == pytest.approx(8)
    assert "hole" in mended.repairs and str(tmp_path) not in mended.repairs
    for name, content, words in (
        ("junk.stl", b"not a mesh at all", "junk.stl"),
        ("model.fbx", b"x", "unknown kind of file"),
        ("big.obj", CUBE.encode() * 100, "at most 0 MB"),
    ):
        with pytest.raises(BadInput, match=words) as found:
            read_upload(content, name, tmp_path / name, limit=10_000)
        assert "\n" not in str(found.value) and str(tmp_path) not in str(found.value)


def test_an_upload_stays_in_its_own_folder_whatever_it_is_called(tmp_path):
    entry = read_upload(CUBE.encode(), "../../../escape.obj", tmp_path / "own", limit=10_000)
    assert [path.name for path in tmp_path.rglob("*")] == ["own", "mesh.obj"]
    assert entry.label == "escape.obj" and entry.shape.name == "mesh"  # so it never meets a shipped model


def test_an_uploaded_mesh_travels_with_its_scene_and_replays(breakers, tmp_path):
    entry = read_upload(OPEN_CUBE.encode(), "mine.obj", tmp_path / "up", limit=10_000)
    session = Session(breakers, entry, Setup("voronoi", "glass", seed=4))
    finish(session)
    session.shoot(*aim(session, "shape"), Shot(radius=0.4, speed=30.0))
    finish(session, 30)
    recording = session.recording()
    assert session.readout().fragments > 1
    name, content = make_file("scene", recording, session.scene(), entry)
    session.close()
    assert name == "scene.zip"
    zipfile.ZipFile(BytesIO(content)).extractall(tmp_path / "unpacked")
    scene = load_scene(tmp_path / "unpacked" / "scene.toml")
    shape = load_shape(scene.shapes[0].shape, repair=scene.shapes[0].repair)
    glass = {"glass": material("glass")}
    again = simulate(scene, [shape], snapper(), np.random.default_rng(scene.seed), materials=glass)
    assert again.recording.frames == recording.frames
    for ours, theirs in zip(recording.tracks, again.recording.tracks, strict=True):
        assert ours.positions.tobytes() == theirs.positions.tobytes()


def test_a_plain_body_shows_all_its_faces_and_keeps_its_creases():
    shape = load_shape("bar")
    ((look, vertices, faces),) = plain_surfaces(shape.mesh, None, shape, "shape")
    assert look == "outer" and len(faces) == len(shape.mesh.faces)
    assert np.allclose(vertices[faces], shape.mesh.triangles, atol=1e-6)
    at_corner = np.all(np.abs(vertices - vertices[np.abs(vertices).sum(axis=1).argmax()]) < 1e-6, axis=1)
    assert at_corner.sum() == 3  # a box's corner belongs to three sides that do not shade into each other
    source = np.where(np.arange(len(shape.mesh.faces)) < 4, -1, np.arange(len(shape.mesh.faces)))
    parts = {look: faces for look, _, faces in plain_surfaces(shape.mesh, source, shape, "fragment")}
    assert len(parts["inner"]) == 4 and len(parts["outer"]) == len(shape.mesh.faces) - 4
