"""Scenes: round trips, one-line errors, builders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import BadInput, Mesh, Shape
from deepfracture.world import (
    KINDS,
    Ball,
    Block,
    Floor,
    Placed,
    Scene,
    draw_scene,
    load_scene,
    save_scene,
    single_ball_scene,
    throw_scene,
)

EXAMPLES = sorted((Path(__file__).parents[3] / "examples" / "scenes").glob("*.toml"))


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
    impulse_fraction=1.0,
    engine="bullet",
    seed=12,
    breaker="voronoi",
    refracture=2,
    blocks=(
        Block((0.0, 1.0, 2.0), (0.5, 0.25, 1 / 3)),
        Block((-1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.8, 0.0, 0.6, 0.0), 0.1),
    ),
)


@pytest.mark.parametrize("name", ["scene.toml", "scene.json"])
@pytest.mark.parametrize("scene", [FULL, Scene((Placed("mug", "glass"),))])
def test_a_scene_survives_its_file(tmp_path: Path, name: str, scene: Scene) -> None:
    save_scene(scene, tmp_path / name)
    assert load_scene(tmp_path / name) == scene
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_scenes(path: Path) -> None:
    scene = load_scene(path)
    assert {placed.shape for placed in scene.shapes} <= {"pot", "mug", "bar"}
    assert len(scene.balls) >= len(scene.shapes)


def test_there_is_an_example_of_every_kind_of_learning_scene() -> None:
    assert {path.stem for path in EXAMPLES} == {"pot_throw", "learning", "falling", *KINDS} - {"single"}


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
        ("refracture = -1\n" + SHAPE, "refracture"),
        ("push = 1.5\n" + SHAPE, "push"),
        ("frame_rate = 7\n" + SHAPE, "frame_rate"),
        ('engine = "havok"\n' + SHAPE, "rapier"),
        ("floor = 3\n" + SHAPE, "floor must be a table"),
        (SHAPE + "[[blocks]]\nposition=[0,0,0]\n", "blocks[0] lacks the field 'half_sides'"),
        (SHAPE + "[[blocks]]\nposition=[0,0,0]\nhalf_sides=[1,0,1]\n", "blocks[0].half_sides"),
        (SHAPE + "[[blocks]]\nposition=[0,0,0]\nhalf_sides=[1,1,1]\nquat_wxyz=[2,0,0,0]\n", "blocks[0].quat_wxyz"),
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
        scene = single_ball_scene("box", _box(), rng, material="glass", speed=(5, 10))
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
        single_ball_scene("box", _box(), np.random.default_rng(0), material="glass", distance=1.0)


def _draw(kind: str, number: int, seed: int = 0, shape: Shape | None = None) -> Scene:
    rng = np.random.default_rng(number)
    return draw_scene(kind, shape or _box(), rng, material="glass", speed=(4.0, 12.0), seed=seed)


def _line(ball: Ball) -> tuple[np.ndarray, np.ndarray, float]:
    """Start, direction and speed of a ball."""
    speed = float(np.linalg.norm(ball.velocity))
    return np.array(ball.position), np.array(ball.velocity) / speed, speed


@pytest.mark.parametrize("kind", KINDS)
def test_learning_scenes_follow_from_their_generator(kind: str) -> None:
    assert _draw(kind, 3) == _draw(kind, 3)
    assert _draw(kind, 3) != _draw(kind, 4)
    scene = _draw(kind, 3)
    assert scene.gravity == 0 and scene.floor is None
    assert all(4 <= _line(ball)[2] <= 12 for ball in scene.balls)


def test_single_is_the_scene_that_it_was() -> None:
    old = single_ball_scene("box", _box(), np.random.default_rng(3), material="glass", speed=(4.0, 12.0))
    assert _draw("single", 3) == old


def test_an_unknown_kind_is_one_line() -> None:
    with pytest.raises(BadInput, match=r"single, dual, strength, points, shear, got 'triple'"):
        _draw("triple", 0)


def test_two_balls_arrive_together_from_apart() -> None:
    for number in range(30):
        one, two = _draw("dual", number).balls
        angle = np.degrees(np.arccos(np.dot(one.position, two.position) / 2.5**2))
        assert angle >= 45
        assert min(one.delay, two.delay) == 0
        arrivals = []
        for ball in (one, two):
            start, direction, speed = _line(ball)
            near, far = _crossing(start, direction)
            assert near <= far  # its line meets the box
            # Goals are on the surface: on this convex box where the line enters it or leaves it.
            arrivals.append(ball.delay + np.array([near, far]) / speed)
        assert np.abs(arrivals[0][:, None] - arrivals[1]).min() < 1e-9


def _crossing(start: np.ndarray, direction: np.ndarray) -> tuple[float, float]:
    """Where a line enters the box of `_box` and leaves it."""
    half = np.array([1.0, 0.5, 0.3])
    ends = np.sort(np.stack([(-half - start) / direction, (half - start) / direction]), axis=0)
    return float(ends[0].max()), float(ends[1].min())


def test_strength_varies_along_one_line() -> None:
    shots = [_line(_draw("strength", number).balls[0]) for number in range(20)]
    assert np.ptp([start for start, _, _ in shots], axis=0).max() == 0
    assert np.ptp([direction for _, direction, _ in shots], axis=0).max() < 1e-12
    assert np.ptp([speed for _, _, speed in shots]) > 4
    other = _line(_draw("strength", 0, seed=1).balls[0])
    assert np.linalg.norm(other[0] - shots[0][0]) > 0.1


def test_points_vary_along_one_direction() -> None:
    shots = [_line(_draw("points", number).balls[0]) for number in range(200)]
    directions = np.array([direction for _, direction, _ in shots])
    assert np.ptp(directions, axis=0).max() < 1e-12
    starts = np.array([start for start, _, _ in shots])
    assert np.abs(np.linalg.norm(starts, axis=1) - 2.5).max() < 1e-9
    for start, direction, _ in shots:
        near, far = _crossing(start, direction)
        assert near <= far + 1e-9
    # They cover the silhouette: as wide as the box is, seen from there.
    corners = _box().mesh.vertices
    across = np.linalg.svd(directions[:1])[2][1:]
    assert (np.ptp(starts @ across.T, axis=0) > 0.85 * np.ptp(corners @ across.T, axis=0)).all()


def test_the_shear_ball_comes_down_beside_an_edge() -> None:
    shape = _box()
    for number in range(20):
        scene = _draw("shear", number, shape=shape)
        first, second = scene.blocks
        edge = first.position[0] + first.half_sides[0]
        ball = scene.balls[0]
        assert ball.velocity[0] == ball.velocity[1] == 0
        assert 0.03 <= ball.position[0] - edge <= 0.15
        assert ball.position[0] < second.position[0] - second.half_sides[0]
        turned = shape.mesh.vertices @ rotation_matrix(np.array(scene.shapes[0].quat_wxyz)).T
        assert np.ptp(turned[:, 0]) == pytest.approx(2.0)
        for block in scene.blocks:  # the shape lies on both
            assert block.position[2] + block.half_sides[2] == pytest.approx(turned[:, 2].min(), abs=1e-6)
        assert ball.position[2] - ball.radius > turned[:, 2].max()


def test_renamed_fields_still_work_with_a_warning() -> None:
    placed = Placed("pot", "glass")
    with pytest.warns(DeprecationWarning, match=r"Scene\.push is now called impulse_fraction"):
        scene = Scene((placed,), **{"push": 0.5})
    with pytest.warns(DeprecationWarning, match="refracture_by"):
        scene = replace(scene, **{"again": "balls"})
    with pytest.warns(DeprecationWarning, match="angular_velocity"):
        assert getattr(replace(placed, **{"spin": (1, 2, 3)}), "spin") == (1.0, 2.0, 3.0)  # noqa: B009
    assert (scene.impulse_fraction, scene.refracture_by) == (0.5, "balls")
    with pytest.warns(DeprecationWarning):
        assert getattr(scene, "push") == 0.5  # noqa: B009


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_files_keep_the_keys_push_again_and_spin(tmp_path: Path, suffix: str) -> None:
    placed = Placed("pot", "glass", angular_velocity=(1, 2, 3))
    scene = Scene((placed,), impulse_fraction=0.5, refracture_by="balls")
    path = tmp_path / f"scene{suffix}"
    save_scene(scene, path)
    text = path.read_text(encoding="utf-8")
    assert all(key in text for key in ("push", "again", "spin"))
    assert not any(name in text for name in ("impulse_fraction", "refracture_by", "angular_velocity"))
    assert load_scene(path) == scene
    path.write_text(text.replace("0.5", "1.5"), encoding="utf-8")
    with pytest.raises(BadInput, match=r"push must be at most 1, got 1\.5"):
        load_scene(path)
