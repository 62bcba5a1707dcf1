"""A scene in motion: balls thrown while it runs, and the same again from its scene file."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture.fracture import material
from deepfracture.geometry import builtin
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import BadInput
from deepfracture.world import Ball, Floor, Live, Scene, load_scene, place_on_floor, save_scene, simulate
from deepfracture.world.floor_penetration import PENETRATION_SLOP

snapper = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "snap.py"))["snapper"]
GLASS = {"glass": material("glass")}


def open_live(shape, refracture_by="balls", **options):
    scene = Scene(
        (place_on_floor(shape.name, shape, material="glass"),),
        floor=Floor(),
        refracture=2,
        refracture_by=refracture_by,
        seed=3,
        **options,
    )
    return Live(scene, [shape], snapper(), np.random.default_rng(scene.seed), materials=GLASS)


def ball(height, speed=14.0, radius=0.15):
    return Ball(radius, 7800.0, (1.2, 0.1, height), (-speed, 0.0, 0.0))


def run(live, frames=600):
    for _ in range(frames):
        if not live.advance():
            break


def same(first, second):
    return len(first.tracks) == len(second.tracks) and all(
        a.name == b.name
        and a.start == b.start
        and a.positions.tobytes() == b.positions.tobytes()
        and a.quats_wxyz.tobytes() == b.quats_wxyz.tobytes()
        for a, b in zip(first.tracks, second.tracks, strict=True)
    )


@pytest.fixture(scope="module")
def played():
    """A bar that was hit, its pieces hit while they fell, and again after they had come to rest."""
    shape = builtin("bar")
    live = open_live(shape)
    run(live, 7)
    live.throw(ball(0.2))
    run(live, 20)
    live.throw(ball(0.3, speed=20.0))
    live.throw(Ball(0.1, 7800.0, (0.0, 1.5, 0.2), (0.0, -12.0, 0.0)))
    run(live)
    assert live.at_rest
    live.throw(ball(0.15, speed=25.0))
    run(live)
    yield shape, live
    live.close()


def test_a_played_scene_repeats_itself_from_its_file(played, tmp_path):
    shape, live = played
    outcome = live.outcome()
    assert len(outcome.breaks) >= 2  # the whole, and a piece of it
    assert {c.generation for c in outcome.breaks} >= {0, 1}
    save_scene(live.scene(), tmp_path / "scene.toml")
    scene = load_scene(tmp_path / "scene.toml")
    again = simulate(scene, [shape], snapper(), np.random.default_rng(scene.seed), materials=GLASS)
    assert same(again.recording, outcome.recording)
    assert [c.body for c in again.collisions] == [c.body for c in outcome.collisions]
    other = simulate(scene, [shape], snapper(), np.random.default_rng(9), materials=GLASS)
    assert not same(other.recording, outcome.recording)


def test_a_scene_stopped_in_mid_flight_repeats_itself_too():
    shape = builtin("bar")
    with open_live(shape) as live:
        live.throw(ball(0.2))
        run(live, 33)
        again = simulate(live.scene(), [shape], snapper(), np.random.default_rng(3), materials=GLASS)
        assert again.recording.frames == live.frames == 34
        assert same(again.recording, live.outcome().recording)


def test_time_stands_still_while_everything_rests(played):
    _, live = played
    frames = live.frames
    assert live.at_rest
    assert [live.advance() for _ in range(3)] == [False] * 3
    assert live.frames == frames == live.outcome().recording.frames


def test_poses_are_those_of_the_recording_and_between_two_frames_between_them(played):
    _, live = played
    recording = live.outcome().recording
    moving = [track for track in recording.tracks if track.kind not in ("floor", "block")]
    for frame in (0, 12, recording.frames - 1):
        poses = {pose.name: pose for pose in live.at(frame)}
        there = [track for track in moving if track.start <= frame < track.stop]
        assert set(poses) == {track.name for track in there}
        for track in there:
            assert np.array_equal(poses[track.name].position, track.positions[frame - track.start])
            assert np.array_equal(poses[track.name].quat_wxyz, track.quats_wxyz[frame - track.start])
    ball = next(track for track in moving if track.kind == "ball")
    (half,) = [pose for pose in live.at(ball.start + 0.5) if pose.name == ball.name]
    assert np.allclose(half.position, ball.positions[:2].mean(axis=0))
    assert np.isclose(np.linalg.norm(half.quat_wxyz), 1)


def test_only_balls_that_came_later_break_fragments_again(played):
    _, live = played
    entered = {f"ball{i}": one.delay for i, one in enumerate(live.scene().balls)}
    born = {track.name: track.start / 60 for track in live.outcome().recording.tracks}
    struck = [c for c in live.collisions if c.generation > 0]
    assert struck
    for collision in struck:
        assert any(delay > born[collision.body] - 1 / 60 and delay < collision.time for delay in entered.values())


def test_without_a_ball_no_fragment_is_asked_where_only_balls_break_them():
    shape = builtin("bar")
    asked = {}
    for again in ("balls", "anything"):
        with open_live(shape, again) as live:
            live.throw(ball(0.2))
            run(live, 90)
            asked[again] = sum(c.generation > 0 for c in live.collisions)
    assert asked["balls"] == 0 < asked["anything"]


@pytest.mark.parametrize("engine", ["bullet", "rapier"])
def test_a_heavy_ball_presses_nothing_into_the_floor(engine):
    """880 kg at 20 m/s from above: Bullet by itself lets pieces sink in by 12 mm here."""
    with open_live(builtin("bar"), engine=engine) as live:
        live.throw(Ball(0.3, 7800.0, (0.2, 0.1, 1.5), (0.0, 0.0, -20.0)))
        run(live, 90)
        tracks = live.outcome().recording.tracks
    pieces = [track for track in tracks if track.kind == "fragment"]
    assert len(pieces) > 1
    for track in pieces:
        corners = np.concatenate(track.rigid.hulls)
        lowest = [
            (corners @ rotation_matrix(quat)[2]).min() + place[2]
            for quat, place in zip(track.quats_wxyz, track.positions, strict=True)
        ]
        assert min(lowest) > -1.001 * PENETRATION_SLOP


def test_fields_of_a_scene_that_are_new_survive_their_file(tmp_path):
    shape = builtin("bar")
    scene = Scene((place_on_floor("bar", shape, material="glass", repair=True),), refracture_by="balls")
    save_scene(scene, tmp_path / "scene.toml")
    assert load_scene(tmp_path / "scene.toml") == scene
    with pytest.raises(BadInput, match="refracture_by must be anything or balls"):
        replace(scene, refracture_by="never")
    with pytest.raises(BadInput, match="repair must be true or false"):
        replace(scene.shapes[0], repair="yes")
