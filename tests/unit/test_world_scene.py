"""Scenes: round trips, one-line errors, builders."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepfracture.types import BadInput, Mesh, Shape
from deepfracture.world import Ball, Floor, Placed, Scene, learning_scene, load_scene, save_scene, throw_scene

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "scenes").glob("*.toml"))


def _box(half: tuple[float, float, float] = (1.0, 0.5, 0.3)) -> Shape:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return Shape("box", Mesh(corners, np.array(faces)))


FULL = Scene(
    shapes=(
        Placed("pot", "ceramic", (0.1, 0.2, 1.0), (0.6, 0.8, 0.0, 0.0), (1.0, 0.0, -1e-7), (0.0, 2.5, 0.0)),
        Placed('odd "name".obj', "glass"),
    ),
    balls=(Ball(0.1, 7800.0, (1.0, 2.0, 3.0), (0.0, -20.0, 1 / 3), delay=0.25),),
    floor=Floor(-0.5, 0.7),
    gravity=1.62,
    duration=3.5,
    frame_rate=30,
    steps_per_second=480,
    friction=0.4,
    restitution=0.0,
    push=1.0,
    engine="bullet",
    seed=12,
    breaker="voronoi",
)


@pytest.mark.parametrize("name", ["scene.toml", "scene.json"])
@pytest.mark.parametrize("scene", [FULL, Scene((Placed("mug", "glass"),))])
def test_a_scene_survives_its_file(tmp_path: Path, name: str, scene: Scene) -> None:
    save_scene(scene, tmp_path / name)
    assert load_scene(tmp_path / name) == scene
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_scenes(path: Path) -> None:
    assert load_scene(path).shapes[0].shape == "pot"


def test_there_are_three_examples() -> None:
    assert {path.stem for path in EXAMPLES} == {"pot_throw", "learning", "falling"}


def test_mesh_files_are_looked_for_beside_the_scene(tmp_path: Path) -> None:
    (tmp_path / "thing.obj").write_text("v 0 0 0\n")
    save_scene(Scene((Placed("thing.obj", "glass"), Placed("pot", "glass"))), tmp_path / "s.toml")
    first, second = load_scene(tmp_path / "s.toml").shapes
    assert first.shape == str(tmp_path / "thing.obj")
    assert second.shape == "pot"


SHAPE = '[[shapes]]\nshape = "pot"\nmaterial = "glass"\n'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("gravitty = 1\n" + SHAPE, "gravitty"),
        (SHAPE + "speed = 1\n", "shapes[0] has an unknown field 'speed'"),
        ('[[shapes]]\nshape = "pot"\n', "shapes[0] lacks the field 'material'"),
        (SHAPE + "position = [1, 2]\n", "shapes[0].position"),
        (SHAPE + "quat_wxyz = [2, 0, 0, 0]\n", "shapes[0].quat_wxyz"),
        (SHAPE + "[[balls]]\nradius=-1\ndensity=1\nposition=[0,0,0]\nvelocity=[0,0,0]\n", "balls[0].radius"),
        (SHAPE + "[[balls]]\nradius=nan\ndensity=1\nposition=[0,0,0]\nvelocity=[0,0,0]\n", "balls[0].radius"),
        (SHAPE + "[floor]\nfriction = 'high'\n", "floor.friction"),
        ("duration = 0\n" + SHAPE, "duration"),
        ("push = 1.5\n" + SHAPE, "push"),
        ("frame_rate = 7\n" + SHAPE, "frame_rate"),
        ('engine = "havok"\n' + SHAPE, "rapier"),
        ("floor = 3\n" + SHAPE, "floor must be a table"),
        ("balls = 3\n" + SHAPE, "balls must be a list"),
        ("", "lacks the field 'shapes'"),
        ("shapes = []\n", "shapes"),
        ("this is not toml", "TOML"),
    ],
)
def test_bad_scenes_are_refused_in_one_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        load_scene(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert says in message
    assert "\n" not in message


def test_missing_and_strange_files(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot be read"):
        load_scene(tmp_path / "none.toml")
    with pytest.raises(BadInput, match=r"\.toml or \.json"):
        load_scene(tmp_path / "scene.yaml")
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="not UTF-8"):
        load_scene(tmp_path / "bytes.json")


def test_a_throw_goes_through_the_point_of_aim() -> None:
    aim = np.array([0.2, -0.1, 0.25])
    scene = throw_scene(
        "box",
        _box(),
        np.random.default_rng(0),
        material="glass",
        aim=aim,
        direction=np.array([1.0, 1.0, 0.0]),
        speed=12,
    )
    placed, ball = scene.shapes[0], scene.balls[0]
    assert 0 < placed.position[2] - 0.3 < 0.01  # it stands on the floor
    goal = np.array(placed.position) + aim
    time = (goal[0] - ball.position[0]) / ball.velocity[0]
    there = np.array(ball.position) + np.array(ball.velocity) * time - [0, 0, 9.81 * time**2 / 2]
    np.testing.assert_allclose(there, goal, atol=1e-9)
    assert np.linalg.norm(ball.velocity) == pytest.approx(12)


def test_learning_balls_come_from_everywhere_towards_the_centre() -> None:
    rng = np.random.default_rng(5)
    starts = []
    for _ in range(200):
        scene = learning_scene("box", _box(), rng, material="glass", speed=(5, 10))
        ball = scene.balls[0]
        position, velocity = np.array(ball.position), np.array(ball.velocity)
        assert np.linalg.norm(np.cross(position, velocity)) < 1e-9
        assert position @ velocity < 0
        assert 5 <= np.linalg.norm(velocity) <= 10
        starts.append(position / np.linalg.norm(position))
    assert scene.gravity == 0
    assert scene.floor is None
    assert np.linalg.norm(np.mean(starts, axis=0)) < 0.2  # uniform on the sphere: about 0.07


def test_a_ball_must_start_outside() -> None:
    with pytest.raises(BadInput, match="distance"):
        learning_scene("box", _box(), np.random.default_rng(0), material="glass", distance=1.0)
