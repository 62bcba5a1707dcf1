"""The Python interface: one import that costs nothing, and what its functions give back or refuse."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import deepfracture as df
from deepfracture.geometry import closest_points, signed_distance_points
from deepfracture.world import Outcome, load_scene

CUBE = """v 0 0 0
v 4 0 0
v 4 2 0
v 0 2 0
v 0 0 2
v 4 0 2
v 4 2 2
v 0 2 2
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


@pytest.fixture(scope="module")
def pot() -> df.Shape:
    return df.load("pot")


@pytest.fixture(scope="module")
def breaker(pot: df.Shape) -> df.Breaker:
    return df.breaker("voronoi", pot, resolution=32)


@pytest.fixture(scope="module")
def outcome(pot: df.Shape, breaker: df.Breaker) -> Outcome:
    return df.throw(pot, breaker, speed=10, seed=3)


def test_the_import_is_instant_and_every_name_can_be_had() -> None:
    code = (
        "import sys, deepfracture as df\n"
        "heavy = {'numpy', 'numba', 'scipy', 'torch', 'rapier3d', 'viser', 'zarr', 'pyvista'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "missing = [name for name in dir(df) if not hasattr(df, name)]\n"
        "assert not missing, missing\n"
        "assert 'torch' not in sys.modules and 'viser' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_name_that_does_not_exist_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="shater"):
        df.shater  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


def test_type_checkers_see_the_same_names_as_python() -> None:
    text = Path(df.__file__).read_text(encoding="utf-8")
    imported = set(re.findall(r"^    from deepfracture\.\w+ import (\w+) as \1$", text, re.M))
    assert imported == set(df._HOME)


def test_no_name_is_hidden_by_a_room_of_the_package() -> None:
    rooms = {path.stem for path in Path(df.__file__).parent.iterdir()}
    assert not rooms & set(df._HOME)


def test_load_reads_files_and_repairs_when_asked(tmp_path: Path) -> None:
    path = tmp_path / "brick.obj"
    path.write_text(CUBE)
    brick = df.load(path)
    assert brick.scale == 2 and brick.to_user(brick.to_body([1, 2, 0.5])) == pytest.approx([1, 2, 0.5])
    path.write_text(CUBE.rsplit("f", 1)[0])  # one side is missing
    with pytest.raises(df.BadInput, match="--repair"):
        df.load(path)
    assert df.load(path, repair=True).mesh.volume == pytest.approx(brick.mesh.volume)


def test_hit_follows_the_ray_to_where_it_first_enters(pot: df.Shape) -> None:
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(60):
        direction = rng.standard_normal(3)
        point = rng.uniform(-0.4, 0.4, 3) - 3 * direction / np.linalg.norm(direction)
        try:
            blow = df.hit(pot, point, direction, impulse=1, speed=1)
        except df.BadInput:
            continue
        found += 1
        way = np.linspace(0, 1, 200)[:-1, None]
        assert signed_distance_points(pot.mesh, blow.position)[0] == pytest.approx(0, abs=1e-6)
        assert (signed_distance_points(pot.mesh, point + way * (blow.position[0] - point)) < 1e-9).all()
        assert blow.direction[0] @ blow.normal[0] < 0
        again = df.hit(pot, blow.position[0], direction, impulse=1, speed=1)
        assert again.position == pytest.approx(blow.position)
    assert found > 30


def test_hit_without_a_direction_falls_on_the_nearest_place_straight_in(pot: df.Shape) -> None:
    blow = df.hit(pot, (1, 0.2, 0.3), impulse=100, speed=5)
    assert blow.position == pytest.approx(closest_points(pot.mesh, np.array([[1, 0.2, 0.3]])).points)
    assert blow.direction == pytest.approx(-blow.normal)


def test_several_blows_come_strongest_first(pot: df.Shape) -> None:
    points = [(1, 0, 0), (-1, 0, 0)]
    blow = df.hit(pot, points, [(-1, 0, 0), (2, 0, 0)], impulse=[100, 300], speed=5, radius=0.1)
    assert blow.magnitude.tolist() == [300, 100]
    assert blow.position[0, 0] < 0 < blow.position[1, 0]
    assert blow.direction.tolist() == [[1, 0, 0], [-1, 0, 0]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"point": (0, 0)}, "point must be three finite numbers"),
        ({"point": (np.nan, 0, 0)}, "point must be three finite numbers"),
        ({"direction": (0, 0, 0)}, "direction must be one for each point and not zero"),
        ({"direction": (1, 0, 0)}, "does not enter pot"),
        ({"impulse": [1, 2]}, "impulse must be one for each of 1 points"),
        ({"impulse": -1}, "magnitude must be positive"),
        ({"speed": 0}, "speed and radius must be positive"),
    ],
)
def test_hit_refuses_what_makes_no_sense(pot: df.Shape, given: dict, message: str) -> None:
    values = {"point": (2, 0, 0), "direction": (-1, 0, 0), "impulse": 100, "speed": 5, **given}
    with pytest.raises(df.BadInput, match=message):
        df.hit(pot, **values)


def test_stress_decides_whether_the_shape_holds(pot: df.Shape, breaker: df.Breaker) -> None:
    rng = np.random.default_rng(0)
    soft, hard = (df.hit(pot, (1, 0, 0.3), impulse=impulse, speed=5) for impulse in (1, 3000))
    strength = df.material("plaster").strength
    assert df.stress(pot, soft, "plaster") < strength < df.stress(pot, hard, "plaster")
    assert breaker(pot, soft, rng) is None
    fragments = breaker(pot, hard, rng)
    assert fragments is not None
    assert fragments.volume == pytest.approx(pot.mesh.volume, rel=1e-6)


def test_a_material_of_ones_own_decides_too(pot: df.Shape) -> None:
    from dataclasses import replace

    tough = replace(df.material("plaster"), name="tough", strength=1e10)
    blow = df.hit(pot, (1, 0, 0.3), impulse=3000, speed=5)
    rng = np.random.default_rng(0)
    assert df.breaker("voronoi", pot, resolution=32, material=tough)(pot, blow, rng) is None
    assert df.breaker("voronoi", pot, resolution=32)(pot, blow, rng)


def test_throw_is_what_the_scene_and_its_seed_say(pot: df.Shape, breaker: df.Breaker, outcome: Outcome) -> None:
    assert len(outcome.breaks) == 1
    scene = df.throw_scene(pot, speed=10, seed=3)
    again = df.run(scene, "voronoi", resolution=32)
    assert [t.name for t in again.recording.tracks] == [t.name for t in outcome.recording.tracks]
    for one, other in zip(again.recording.tracks, outcome.recording.tracks, strict=True):
        assert np.array_equal(one.positions, other.positions)
    other = df.throw(pot, breaker, speed=10, seed=3, heading=40)
    assert not np.array_equal(other.recording.tracks[-1].positions, outcome.recording.tracks[-1].positions)


def test_throw_is_what_the_command_line_throws(tmp_path: Path, outcome: Outcome) -> None:
    from deepfracture.cli import main

    options = ["--breaker", "voronoi", "--resolution", "32", "--speed", "10", "--seed", "3", "--no-film"]
    main(["shatter", "pot", "--out", str(tmp_path), *options])
    df.save(outcome, tmp_path / "ours.glb")
    assert (tmp_path / "ours.glb").read_bytes() == (tmp_path / "animation.glb").read_bytes()


def test_options_are_given_whole_or_by_name(pot: df.Shape) -> None:
    options = df.BreakerOptions(resolution=32, max_faces=300)
    by_name = df.breaker("voronoi", pot, resolution=32, max_faces=300)
    with pytest.warns(DeprecationWarning, match="budget is deprecated, use max_faces") as caught:
        deprecated = df.breaker("voronoi", pot, resolution=32, budget=300)
    assert len(caught) == 1 and caught[0].filename == __file__
    blow = df.hit(pot, (1, 0, 0.3), impulse=3000, speed=10)
    whole, *others = (
        one(pot, blow, np.random.default_rng(0)) for one in (df.breaker("voronoi", pot, options), by_name, deprecated)
    )
    for other in others:
        assert whole is not None and other is not None
        assert all(np.array_equal(a.mesh.faces, b.mesh.faces) for a, b in zip(whole, other, strict=True))
    with pytest.raises(df.BadInput, match=r"no option 'resolutoin'.*did you mean 'resolution'"):
        df.breaker("voronoi", pot, resolutoin=32)


def test_any_function_can_be_a_breaker_if_the_material_is_known(pot: df.Shape, breaker: df.Breaker) -> None:
    def mine(shape: df.Shape, impact: df.Impact, rng: np.random.Generator) -> df.Fragments | None:
        return breaker(shape, impact, rng)

    with pytest.raises(df.BadInput, match="material must be given"):
        df.throw(pot, mine)
    assert df.throw(pot, mine, material="plaster", speed=10, seed=3).breaks


@pytest.mark.parametrize(
    ("given", "message"), [({"up": "w"}, "up must be"), ({"speed": 0}, "speed"), ({"engine": "x"}, "engine")]
)
def test_throw_refuses_values_out_of_range(pot: df.Shape, breaker: df.Breaker, given: dict, message: str) -> None:
    with pytest.raises(df.BadInput, match=message):
        df.throw(pot, breaker, **given)


def test_run_refuses_what_does_not_fit_the_scene(pot: df.Shape, breaker: df.Breaker) -> None:
    from dataclasses import replace

    scene = df.throw_scene(pot)
    with pytest.raises(df.BadInput, match="shapes must be the scene's 1, got 2"):
        df.run(scene, breaker, shapes=[pot, pot])
    with pytest.raises(df.BadInput, match="materials lacks 'plaster'"):
        df.run(scene, breaker, materials={"clay": df.material("ceramic")})
    with pytest.raises(df.BadInput, match="model and dataset go with the name"):
        df.run(scene, breaker, model="x.safetensors")
    with pytest.raises(df.BadInput, match="breaks no fragments again"):
        df.run(replace(scene, refracture=1), "cvd")
    with pytest.raises(df.BadInput, match="granite"):
        df.throw(pot, breaker, material="granite")


def test_saving_goes_by_what_it_is_and_by_suffix(tmp_path: Path, pot: df.Shape, outcome: Outcome) -> None:
    collision = outcome.breaks[0]
    assert collision.fragments is not None
    count = len(collision.fragments)
    assert len(list(df.save(collision, tmp_path / "pieces").glob("*.ply"))) == count
    df.save(collision.fragments, tmp_path / "same", shape=pot)
    for path in (tmp_path / "pieces").iterdir():
        assert path.read_bytes() == (tmp_path / "same" / path.name).read_bytes()
    assert df.save(collision, tmp_path / "pieces.png").read_bytes()[:4] == b"\x89PNG"
    assert (
        df.save(outcome, tmp_path / "pot.glb").read_bytes()
        == df.save(outcome.recording, tmp_path / "again.glb").read_bytes()
    )
    frames = df.save(outcome, tmp_path / "frames", kind="ply", rate=2)
    assert len(list(frames.glob("frame_*.ply"))) == int(outcome.recording.duration * 2) + 1
    scene = df.throw_scene(pot)
    assert load_scene(df.save(scene, tmp_path / "new" / "scene.toml")) == scene


def test_usd_is_written_by_its_suffix(tmp_path: Path, outcome: Outcome) -> None:
    usd, physics = (
        pytest.importorskip(f"pxr.{name}", reason="usd-core is not installed") for name in ("Usd", "UsdPhysics")
    )
    stage = usd.Stage.Open(str(df.save(outcome, tmp_path / "pot.usda", gravity=1.62)))
    (scene,) = (prim for prim in stage.Traverse() if prim.IsA(physics.Scene))
    scale = outcome.collisions[0].shape.scale  # user's units to the metre of the body frame
    assert physics.Scene(scene).GetGravityMagnitudeAttr().Get() == pytest.approx(1.62 * scale, rel=1e-5)


def test_nothing_is_saved_of_a_failure(tmp_path: Path, pot: df.Shape, breaker: df.Breaker, outcome: Outcome) -> None:
    fragments = breaker(pot, df.hit(pot, (1, 0, 0), impulse=1, speed=1), np.random.default_rng(0))
    with pytest.raises(df.BadInput, match="nothing broke"):
        df.save(fragments, tmp_path / "pieces", shape=pot)
    with pytest.raises(df.BadInput, match="shape must be given"):
        df.save(outcome.breaks[0].fragments, tmp_path / "pieces")
    with pytest.raises(df.BadInput, match=r"as \.glb.*not as \.gif"):
        df.save(outcome, tmp_path / "pot.gif")
    with pytest.raises(df.BadInput, match="can be saved"):
        df.save(pot, tmp_path / "pot.obj")  # pyright: ignore[reportArgumentType]
    assert not list(tmp_path.iterdir())


def test_data_and_model_are_made_and_used(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed")
    bar = df.load("bar")
    data = df.simulate(bar, tmp_path / "data", collisions=4, speed=(15, 30), resolution=32, workers=1)
    assert len(data) > 1
    model = df.train(data, tmp_path / "run", epochs=2)
    blow = data.impacts()[0]
    assert df.breaker("nearest", bar, dataset=tmp_path / "data")(bar, blow, np.random.default_rng(0))
    assert df.breaker("learned", bar, model=model)  # two passes teach it nothing
    with pytest.raises(df.BadInput, match="width 2"):
        df.train(data, tmp_path / "other", width=2)
    with pytest.raises(df.BadInput, match="preset must be"):
        df.train(data, tmp_path / "other", preset="papre")
