"""The rigid-body world against conservation laws and closed forms, on every engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from deepfracture.geometry import MassProperties, builtin, mass_properties, signed_distance_points
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import ContactMaterial, Fragment, Fragments, Impact, Material, Mesh, Recording, Shape
from deepfracture.world import (
    Ball,
    Block,
    Floor,
    Outcome,
    Placed,
    Scene,
    draw_scene,
    first_impact,
    joint_impact,
    simulate,
    single_ball_scene,
    throw_scene,
)
from deepfracture.world.collisions import CollisionEvent
from deepfracture.world.engine import BodyState
from deepfracture.world.engines import open_engine
from deepfracture.world.physics_world import PhysicsWorld

ENGINES = [
    "rapier",
    pytest.param("bullet", marks=pytest.mark.skipif(find_spec("pybullet") is None, reason="no pybullet wheel here")),
]
every_engine = pytest.mark.parametrize("engine", ENGINES)
STONE = {"stone": Material("stone", 5e10, 0.2, 2400.0, 1e7, 1e6, 10.0)}
Split = tuple[Sequence[float], float]


def _pieces(mesh: Mesh, cuts: Sequence[Split]) -> Fragments:
    """What planes (normal, offset) cut a mesh into."""
    import manifold3d

    whole = manifold3d.Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    parts = [manifold3d.Manifold(whole)]
    for normal, offset in cuts:
        sides = (side for part in parts for side in part.split_by_plane(list(normal), offset))
        parts = [side for side in sides if not side.is_empty()]
    solids = [solid for part in parts for solid in part.decompose() if solid.volume() > 1e-6]
    return Fragments(tuple(_fragment(solid) for solid in solids))


def _fragment(solid: object) -> Fragment:
    raw = solid.to_mesh()  # type: ignore[attr-defined]
    mesh = Mesh(np.asarray(raw.vert_properties, float)[:, :3], np.asarray(raw.tri_verts, np.int64))
    have = mass_properties(mesh, STONE["stone"].density)
    return Fragment(mesh, np.full(len(mesh.faces), -1), have.mass, have.centre, have.inertia)


def _planes(rng: np.random.Generator, n: int, reach: float = 0.4) -> list[Split]:
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return [(normal.tolist(), float(rng.uniform(-reach, reach))) for normal in normals]


def _cutter(cuts: Sequence[Split]) -> Callable[[Shape, Impact, np.random.Generator], Fragments]:
    return lambda shape, impact, rng: _pieces(shape.mesh, cuts)


def _never(shape: Shape, impact: Impact, rng: np.random.Generator) -> None:
    return None


def _mass(shape: Shape) -> MassProperties:
    return mass_properties(shape.mesh, STONE["stone"].density)


def _momentum(engine_bodies: Sequence[tuple[MassProperties, BodyState]]) -> tuple[np.ndarray, np.ndarray]:
    """Linear and angular momentum about the origin."""
    linear, angular = np.zeros(3), np.zeros(3)
    for mass, motion in engine_bodies:
        turn = rotation_matrix(motion.quat_wxyz)
        centre = motion.position + turn @ mass.centre
        linear += mass.mass * motion.velocity
        angular += mass.mass * np.cross(centre, motion.velocity)
        angular += turn @ mass.inertia @ turn.T @ motion.angular_velocity
    return linear, angular


def _still(position: Sequence[float] = (0, 0, 0)) -> BodyState:
    return BodyState(np.array(position, float), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))


def _run(scene: Scene, shape: Shape, breaker: object = _never, seed: int = 0) -> Outcome:
    return simulate(scene, [shape], breaker, np.random.default_rng(seed), materials=STONE)  # type: ignore[arg-type]


@every_engine
def test_free_fall(engine: str) -> None:
    scene = Scene((Placed("bar", "stone", (0, 0, 5), velocity=(1, 0, 2)),), gravity=9.81, duration=1.0, engine=engine)
    (track,) = _run(scene, builtin("bar")).recording.tracks
    t = np.arange(61) / 60
    exact = np.stack([t, 0 * t, 5 + 2 * t - 9.81 * t**2 / 2], axis=1)
    # Semi-implicit Euler is behind by g t dt / 2, which is 2 cm at the end.
    np.testing.assert_allclose(track.positions, exact, atol=9.81 / 240 / 2 * 1.05)


@every_engine
def test_poses_are_of_the_mesh_frame(engine: str) -> None:
    """A body spins about its centre of mass, wherever the origin of its mesh is."""
    shape = builtin("mug")  # its centre of mass is off the origin, its inertia has products
    mass = _mass(shape)
    world = open_engine(engine, gravity=0.0, contact=ContactMaterial(0.5, 0.2))
    quat = np.array([0.5, 0.5, -0.5, 0.5])
    start = BodyState(np.array([1.0, 2.0, 3.0]), quat, np.zeros(3), np.array([0.3, 2.0, -1.0]))
    body = world.add_body([shape.mesh.vertices[::50]], mass, start)
    first = world.state(body)
    np.testing.assert_allclose(first.position, start.position, atol=1e-6)
    np.testing.assert_allclose(rotation_matrix(first.quat_wxyz), rotation_matrix(quat), atol=1e-6)
    for _ in range(240):
        world.step(1 / 240)
    last = world.state(body)
    world.close()
    centres = [m.position + rotation_matrix(m.quat_wxyz) @ mass.centre for m in (first, last)]
    np.testing.assert_allclose(centres[1], centres[0], atol=1e-4)
    assert np.linalg.norm(last.position - first.position) > 0.01
    before, after = (_momentum([(mass, m)])[1] for m in (first, last))
    # Every body loses a tenth of its spin a second.
    assert np.linalg.norm(after * np.exp(0.1) - before) < 0.05 * np.linalg.norm(before)


@every_engine
@pytest.mark.parametrize("name", ["bar", "pot", "bunny"])
def test_impulse_is_m_dv_and_momentum_is_conserved(engine: str, name: str) -> None:
    shape = builtin(name)
    mass = _mass(shape)
    rng = np.random.default_rng(4)
    square = 0
    for _ in range(8):
        scene = single_ball_scene(name, shape, rng, material="stone", engine=engine)
        hit = _run(scene, shape).collisions[0]
        ball = scene.balls[0]
        impulse = (hit.impact.magnitude[:, None] * hit.impact.direction).sum(axis=0)
        turn = rotation_matrix(hit.before.quat_wxyz)
        gained = mass.mass * (hit.after.velocity - hit.before.velocity)
        assert np.linalg.norm(turn @ impulse - gained) < 0.05 * np.linalg.norm(gained)
        assert hit.impact.radius == ball.radius
        if len(hit.impact.magnitude) > 1 or hit.impact.direction[0] @ hit.impact.normal[0] > -0.98:
            continue
        # One blow, nearly square: the closed form for rigid bodies without friction.
        square += 1
        normal = turn @ hit.impact.normal[0]
        lever = np.cross(turn @ (hit.impact.position[0] - mass.centre), normal)
        soft = 1 / ball.mass + 1 / mass.mass + lever @ np.linalg.solve(turn @ mass.inertia @ turn.T, lever)
        closing = -np.array(ball.velocity) @ normal
        assert -gained @ normal == pytest.approx((1 + scene.restitution) * closing / soft, rel=0.1)
        assert hit.impact.speed == pytest.approx(closing, rel=0.1)
    assert square >= 2


@every_engine
def test_engine_impulses_alone_are_m_dv(engine: str) -> None:
    """What the engine itself reports, before momentum is asked: a ball squarely on a free bar."""
    shape = builtin("bar")
    mass = _mass(shape)
    for speed in (2.0, 8.0, 40.0):
        dt = min(1 / 240, 0.025 / speed)  # as `PhysicsWorld` does
        world = open_engine(engine, gravity=0.0, contact=ContactMaterial(0.5, 0.2))
        bar = world.add_body([shape.mesh.vertices], mass, _still())
        flight = replace_velocity(_still((0, -0.45, 0)), (0, speed, 0))
        ball = world.add_ball(0.2, 100.0, flight)
        reported = 0.0
        for _ in range(int(0.6 / speed / dt)):
            began = world.state(bar)
            world.step(dt)
            reported += sum(c.impulse for c in world.contacts(bar, began) if c.other == ball)
        gained = mass.mass * world.state(bar).velocity[1]
        lost = 100.0 * (speed - world.state(ball).velocity[1])
        world.close()
        exact = 1.2 * speed / (1 / 100 + 1 / mass.mass)
        assert gained == pytest.approx(exact, rel=0.05)
        assert reported == pytest.approx(gained, rel=0.05)
        assert lost == pytest.approx(gained, rel=1e-3)


def replace_velocity(motion: BodyState, velocity: Sequence[float]) -> BodyState:
    return BodyState(motion.position, motion.quat_wxyz, np.array(velocity, float), motion.angular_velocity)


@every_engine
def test_impulse_on_the_floor(engine: str) -> None:
    """A shape that stands: the blow of the ball and the answer of the floor add up to m dv."""
    shape = builtin("pot")
    scene = throw_scene(
        "pot",
        shape,
        np.random.default_rng(1),
        material="stone",
        direction=np.array([1.0, 0, -0.3]),
        engine=engine,
    )
    outcome = _run(replace(scene, duration=0.5), shape)
    hit = outcome.collisions[0]
    assert len(hit.impact.magnitude) > 1
    impulse = (hit.impact.magnitude[:, None] * hit.impact.direction).sum(axis=0)
    gained = _mass(shape).mass * (hit.after.velocity - hit.before.velocity)
    turn = rotation_matrix(hit.before.quat_wxyz)
    assert np.linalg.norm(turn @ impulse - gained) < 0.05 * hit.impact.magnitude.sum()
    low = hit.impact.position[:, 2] < -0.9
    assert low.any()
    assert not low.all()
    assert (hit.impact.direction[low, 2] > 0.5).all()  # the floor pushes up


@every_engine
def test_impacts_lie_on_the_true_surface(engine: str) -> None:
    shape = builtin("pot")
    rng = np.random.default_rng(2)
    for _ in range(4):
        scene = single_ball_scene("pot", shape, rng, material="stone", engine=engine)
        impact = first_impact(scene, shape, materials=STONE)
        assert impact is not None
        assert np.abs(signed_distance_points(shape.mesh, impact.position)).max() < 1e-6
        assert (np.einsum("ki,ki->k", impact.normal, impact.direction) < -0.3).all()
        # In the outer normal's direction there is air, against it there is solid.
        out = signed_distance_points(shape.mesh, impact.position + 0.02 * impact.normal)
        into = signed_distance_points(shape.mesh, impact.position - 0.02 * impact.normal)
        assert (out < 0).all()
        assert (into > 0).all()


def test_engines_agree_on_the_first_impact() -> None:
    pytest.importorskip("pybullet", reason="no pybullet wheel here")
    shape = builtin("pot")
    scene = single_ball_scene("pot", shape, np.random.default_rng(6), material="stone")
    one, two = (first_impact(scene, shape, materials=STONE, engine=e) for e in ("rapier", "bullet"))
    assert one is not None
    assert two is not None
    assert np.linalg.norm(one.position[0] - two.position[0]) < 0.02
    assert one.magnitude[0] == pytest.approx(two.magnitude[0], rel=0.03)


def test_a_ball_that_misses_hits_nothing() -> None:
    scene = Scene((Placed("bar", "stone"),), (Ball(0.1, 7800, (0, -2, 3), (0, 10, 0)),), gravity=0.0, duration=1.0)
    assert first_impact(scene, builtin("bar"), materials=STONE) is None


@every_engine
@pytest.mark.parametrize("push", [0.0, 0.3, 1.0])
def test_breaking_conserves_momentum(engine: str, push: float) -> None:
    shape = builtin("bar")
    cuts = _planes(np.random.default_rng(1), 4, 0.2)
    scene = replace(
        single_ball_scene("bar", shape, np.random.default_rng(8), material="stone", engine=engine),
        impulse_fraction=push,
        duration=0.6,
    )
    outcome = _run(scene, shape, _cutter(cuts))
    (broken,) = outcome.breaks
    pieces = list(broken.fragments or ())
    assert len(pieces) > 4
    ball = scene.balls[0]
    solid = MassProperties(ball.mass, np.zeros(3), 0.4 * ball.mass * ball.radius**2 * np.eye(3))
    thrown = replace_velocity(_still(ball.position), ball.velocity)
    before = _momentum([(solid, thrown)])[0]
    # Velocities from the recording's last two frames, of the centres of mass.
    after = np.zeros(3)
    for track in outcome.recording.tracks:
        if track.kind == "shape":
            continue
        mass = solid if track.kind == "ball" else _piece_mass(pieces, track.name)
        ends = [
            p + rotation_matrix(q) @ mass.centre
            for p, q in zip(track.positions[-2:], track.quats_wxyz[-2:], strict=True)
        ]
        after += mass.mass * (ends[1] - ends[0]) / outcome.recording.frame_time
    assert np.linalg.norm(after - before) < 0.01 * np.linalg.norm(before)


def _piece_mass(pieces: list[Fragment], name: str) -> MassProperties:
    piece = pieces[int(name.split(".")[1])]
    return MassProperties(piece.mass, piece.centre, piece.inertia)


@every_engine
def test_angular_momentum_through_a_collision(engine: str) -> None:
    shape = builtin("bar")
    mass = _mass(shape)
    world = open_engine(engine, gravity=0.0, contact=ContactMaterial(0.5, 0.2))
    bar = world.add_body([shape.mesh.vertices], mass, _still())
    solid = MassProperties(100.0, np.zeros(3), 0.4 * 100 * 0.04 * np.eye(3))
    ball = world.add_ball(0.2, 100.0, replace_velocity(_still((0.6, -0.6, 0.1)), (0, 10, 0)))
    start = _momentum([(mass, world.state(bar)), (solid, world.state(ball))])
    for _ in range(40):
        world.step(1 / 960)
    end = _momentum([(mass, world.state(bar)), (solid, world.state(ball))])
    assert np.linalg.norm(world.state(bar).angular_velocity) > 0.5
    world.close()
    assert np.linalg.norm(end[0] - start[0]) < 1e-3 * np.linalg.norm(start[0])
    assert np.linalg.norm(end[1] - start[1]) < 0.02 * np.linalg.norm(start[1])


@every_engine
@pytest.mark.parametrize("moved", [False, True])
def test_a_new_body_has_its_own_inertia_in_its_first_step(engine: str, moved: bool) -> None:
    """A ball hits the end of a bar that stands askew, in the first step after the bar came in or was turned."""
    shape = builtin("bar")
    mass, solid = _mass(shape), MassProperties(100.0, np.zeros(3), 0.4 * 100 * 0.04 * np.eye(3))
    askew = np.array([0.8, 0.2, -0.4, 0.4])
    turn = rotation_matrix(askew)
    gap = np.array([0.6, shape.mesh.vertices[:, 1].min() - 0.2 - 1e-4, 0.1])
    world = open_engine(engine, gravity=0.0, contact=ContactMaterial(0.5, 0.2))
    bar = world.add_body([shape.mesh.vertices], mass, _still() if moved else replace(_still(), quat_wxyz=askew))
    if moved:
        world.step(1 / 960)
        world.set_state(bar, replace(_still(), quat_wxyz=askew))
    ball = world.add_ball(0.2, 100.0, replace_velocity(_still(turn @ gap), turn @ [0, 10, 0]))
    before = _momentum([(mass, world.state(bar)), (solid, world.state(ball))])
    world.step(1 / 960)
    after = _momentum([(mass, world.state(bar)), (solid, world.state(ball))])
    assert np.linalg.norm(world.state(bar).angular_velocity) > 0.5
    world.close()
    assert np.linalg.norm(after[0] - before[0]) < 1e-3 * np.linalg.norm(before[0])
    assert np.linalg.norm(after[1] - before[1]) < 0.02 * np.linalg.norm(before[1])


@every_engine
@pytest.mark.parametrize("name", ["bar", "pot"])
def test_fragments_at_rest_stay_at_rest(engine: str, name: str) -> None:
    """Broken without a push, in zero gravity, nothing flies apart: hulls do not explode by overlap."""
    shape = builtin(name)
    pieces = _pieces(shape.mesh, _planes(np.random.default_rng(3), 5, 0.3))
    assert len(pieces) > 8
    from deepfracture.geometry.convex.hulls import fragment_hulls

    world = open_engine(engine, gravity=0.0, contact=ContactMaterial(0.5, 0.2))
    bodies = [
        world.add_body(hulls.points, MassProperties(piece.mass, piece.centre, piece.inertia), _still())
        for piece, hulls in zip(pieces, fragment_hulls([p.mesh for p in pieces]), strict=True)
    ]
    energy = 0.0
    for _ in range(120):
        world.step(1 / 240)
    for body, piece in zip(bodies, pieces, strict=True):
        motion = world.state(body)
        energy += 0.5 * piece.mass * motion.velocity @ motion.velocity
        energy += 0.5 * motion.angular_velocity @ piece.inertia @ motion.angular_velocity
    world.close()
    mass = sum(piece.mass for piece in pieces)
    assert energy < 0.5 * mass * 0.05**2  # as if all moved at 5 cm/s


def _struck(scene: Scene, shape: Shape) -> tuple[PhysicsWorld, CollisionEvent]:
    """A scene up to its first collision."""
    world = PhysicsWorld(scene, [shape], STONE)
    return world, next(hit for _ in range(500) for hit in world.step())


SPIN = (0.4, -0.6, 0.5)
TWO_BALLS = (Ball(0.2, 7800, (0.5, -1.2, 0.1), (0, 12, 1)), Ball(0.2, 3000, (-0.5, 1.2, -0.1), (0, -12, -1)))


@every_engine
@pytest.mark.parametrize("push", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("balls", [1, 2])
def test_the_swap_conserves_all_momentum(engine: str, push: float, balls: int) -> None:
    """Of the shape and what strikes it, before the contact and with the fragments in its place."""
    shape = builtin("bar")
    scene = Scene(
        (Placed("bar", "stone", angular_velocity=SPIN),),
        TWO_BALLS[:balls],
        gravity=0.0,
        impulse_fraction=push,
        engine=engine,
        duration=1.0,
    )
    world, hit = _struck(scene, shape)
    assert len(hit.strikers) == balls
    begin = [(hit.body.mass, hit.before), *((s.body.mass, s.before) for s in hit.strikers)]
    whole = world.replace(hit, _pieces(shape.mesh, _planes(np.random.default_rng(1), 4, 0.2)))
    end = [(body.mass, motion) for body, motion in world.moving()]
    world.close()
    assert len(whole) > 4
    for before, after in zip(_momentum(begin), _momentum(end), strict=True):
        assert np.linalg.norm(after - before) < 0.01 * np.linalg.norm(before)
    # They stand where the shape and the balls were before the contact.
    for (_, motion), striker in zip(end, hit.strikers, strict=False):
        np.testing.assert_allclose(motion.position, striker.before.position, atol=1e-6)
    for _, motion in end[balls:]:
        np.testing.assert_allclose(motion.position, hit.before.position, atol=1e-6)


@every_engine
def test_what_one_body_took_another_keeps(engine: str) -> None:
    """A ball between two bars; one breaks. What the other got from the ball is not taken back."""
    shape = builtin("bar")
    shapes = tuple(Placed("bar", "stone", (0, y, 0)) for y in (-0.4, 0.4))
    ball = Ball(0.19, 7800, (-0.2, 0.005, 1.2), (0.0, 0.4, -12.0))
    scene = Scene(shapes, (ball,), gravity=0.0, impulse_fraction=0.0, engine=engine, duration=1.0)
    world = PhysicsWorld(scene, [shape, shape], STONE)
    begin = _momentum([(body.mass, motion) for body, motion in world.moving()])[0]
    for _ in range(200):
        for hit in world.step():
            if hit.body.name == "shape0":
                world.replace(hit, _pieces(shape.mesh, _planes(np.random.default_rng(1), 3, 0.2)))
    end = _momentum([(body.mass, motion) for body, motion in world.moving()])[0]
    world.close()
    assert np.linalg.norm(end - begin) < 0.01 * np.linalg.norm(begin)


@every_engine
def test_fragments_with_rough_cracks_do_not_jump(engine: str) -> None:
    """Wavy cracks: the hulls of neighbours would overlap by centimetres. At rest, none gains more than 2 % of
    the kinetic energy that it would have at 1 m/s."""
    from deepfracture.carve import cut
    from deepfracture.geometry.convex.hulls import fragment_hulls
    from deepfracture.types import FracturePattern, Grid

    shape, grid = builtin("bar"), Grid(64)
    x, y, z = np.moveaxis(grid.centres(), -1, 0)
    waves = [x - cut_at + 0.06 * np.sin(16 * y) * np.cos(16 * z) for cut_at in (-0.5, 0.0, 0.4)]
    labels = 1 + np.sum([wave > 0 for wave in waves], axis=0)
    pieces = cut(shape, FracturePattern(grid, labels, np.min(np.abs(waves), axis=0)), density=2400.0)
    assert len(pieces) == 4
    world = open_engine(engine, gravity=0.0, contact=ContactMaterial(0.5, 0.2))
    bodies = [
        world.add_body(hulls.points, MassProperties(piece.mass, piece.centre, piece.inertia), _still())
        for piece, hulls in zip(pieces, fragment_hulls([p.mesh for p in pieces]), strict=True)
    ]
    for _ in range(10):
        world.step(1 / 240)
        for body, piece in zip(bodies, pieces, strict=True):
            motion = world.state(body)
            energy = 0.5 * piece.mass * motion.velocity @ motion.velocity
            energy += 0.5 * motion.angular_velocity @ piece.inertia @ motion.angular_velocity
            assert energy < 0.02 * 0.5 * piece.mass
            # Nor is it put elsewhere: engines may also part bodies without giving them speed.
            assert np.linalg.norm(motion.position) < 0.003
    world.close()


def _lowest(recording: Recording) -> float:
    """Lowest vertex of any fragment in the last frame [m]."""
    return min(
        float((t.mesh.vertices @ rotation_matrix(t.quats_wxyz[-1])[2] + t.positions[-1][2]).min())
        for t in recording.tracks
        if t.kind == "fragment"
    )


@every_engine
def test_a_pile_of_fifty_fragments_comes_to_rest_on_the_floor(engine: str) -> None:
    shape = builtin("base")
    pieces = _pieces(shape.mesh, _planes(np.random.default_rng(0), 8, 0.5))
    assert len(pieces) >= 50
    kept = Fragments(pieces.pieces[:50])
    scene = Scene(
        (Placed("base", "stone", (0, 0, 1.2), (0.9659258, 0.258819, 0, 0)),),
        floor=Floor(),
        duration=12.0,
        engine=engine,
    )
    outcome = simulate(scene, [shape], lambda *_: kept, np.random.default_rng(0), materials=STONE)
    recording = outcome.recording
    assert len(recording.tracks) == 52
    assert recording.duration < 11.9  # it stopped because everything lay still
    assert _lowest(recording) > -0.01
    tracks = [t for t in recording.tracks if t.kind == "fragment"]
    for track in tracks:
        assert np.linalg.norm(track.positions[-1] - track.positions[-2]) < 0.005


@every_engine
def test_standing_and_settling_are_not_collisions(engine: str) -> None:
    shape = builtin("pot")
    scene = Scene((Placed("pot", "stone", (0, 0, 1.003)),), floor=Floor(), duration=3.0, engine=engine)
    outcome = _run(scene, shape)
    assert outcome.collisions == ()
    assert outcome.recording.duration < 1.5
    (track, _) = outcome.recording.tracks
    assert abs(track.positions[-1][2] - 1.0) < 0.01


@every_engine
def test_same_seed_same_recording(engine: str) -> None:
    shape = builtin("pot")
    scene = replace(throw_scene("pot", shape, np.random.default_rng(3), material="stone", engine=engine), duration=0.6)
    cuts = _planes(np.random.default_rng(5), 4)
    first, second = (_run(scene, shape, _cutter(cuts)).recording for _ in range(2))
    assert len(first.tracks) == len(second.tracks) > 6
    for a, b in zip(first.tracks, second.tracks, strict=True):
        assert (a.name, a.start) == (b.name, b.start)
        assert a.positions.tobytes() == b.positions.tobytes()
        assert a.quats_wxyz.tobytes() == b.quats_wxyz.tobytes()


@every_engine
def test_a_recording_has_every_body_when_it_is_there(engine: str) -> None:
    shape = replace(builtin("bar"), scale=0.5, centre=np.array([10.0, 0, 0]))
    scene = Scene(
        (Placed("bar", "stone", (0, 0, 2), (0.8, 0, 0, 0.6)),),
        (Ball(0.2, 7800, (0, -1.5, 2.2), (0, 12, 0)), Ball(0.1, 7800, (3, 0, 1), (0, 0, 0), delay=0.5)),
        floor=Floor(),
        duration=1.5,
        engine=engine,
    )
    outcome = _run(scene, shape, _cutter(_planes(np.random.default_rng(1), 3, 0.2)))
    tracks = {track.name: track for track in outcome.recording.tracks}
    (broken,) = outcome.breaks
    assert tracks["shape0"].start == 0
    assert tracks["shape0"].stop == broken.frame + 1
    pieces = [track for track in tracks.values() if track.kind == "fragment"]
    assert len(pieces) == len(broken.fragments or ())
    assert all(track.start == broken.frame + 1 for track in pieces)
    assert all(track.stop == outcome.recording.frames for track in pieces)
    assert all(track.source is not None for track in pieces)
    assert tracks["ball0"].start == 0
    assert tracks["ball1"].start == 30
    assert tracks["floor"].stop == outcome.recording.frames
    # At the start the shape lies where the user's file has it.
    world = tracks["shape0"].mesh.vertices @ rotation_matrix(tracks["shape0"].quats_wxyz[0]).T
    world = world + tracks["shape0"].positions[0]
    user = world @ outcome.recording.user_from_world[:3, :3].T + outcome.recording.user_from_world[:3, 3]
    np.testing.assert_allclose(user, shape.to_user(shape.mesh.vertices), atol=1e-6)


@every_engine
def test_what_did_not_break_may_break_later(engine: str) -> None:
    """Two balls; only the second blow is strong enough for this breaker."""
    shape = builtin("bar")
    cuts = _planes(np.random.default_rng(1), 3, 0.2)
    scene = Scene(
        (Placed("bar", "stone"),),
        (Ball(0.1, 7800, (0, -1, 0), (0, 3, 0)), Ball(0.1, 7800, (0, 2, 0), (0, -20, 0), delay=0.6)),
        gravity=0.0,
        duration=1.2,
        engine=engine,
    )
    outcome = _run(
        scene,
        shape,
        lambda shape, impact, rng: _pieces(shape.mesh, cuts) if impact.magnitude[0] > 300 else None,
    )
    assert [c.fragments is None for c in outcome.collisions] == [True, False]
    assert outcome.collisions[0].time < 0.6 < outcome.collisions[1].time


@every_engine
def test_a_block_answers_a_blow_that_it_carries(engine: str) -> None:
    """A bar on a block struck from above goes nowhere, so the block gives back what the ball gave."""
    shape = builtin("bar")
    scene = Scene(
        (Placed("bar", "stone"),),
        (Ball(0.2, 7800, (0, 0, 0.7), (0, 0, -8)),),
        gravity=0.0,
        duration=0.2,
        engine=engine,
        blocks=(Block((0, 0, -0.7), (1.5, 1.0, 0.5)),),
    )
    impact = first_impact(scene, shape, materials=STONE)
    assert impact is not None
    up = impact.direction[:, 2] > 0
    given, answered = impact.magnitude[~up].sum(), impact.magnitude[up].sum()
    # The ball meets what cannot give way: m v (1 + e).
    assert given == pytest.approx(1.2 * 8 * scene.balls[0].mass, rel=0.1)
    assert answered == pytest.approx(given, rel=0.1)
    np.testing.assert_allclose(impact.position[up, 2], -0.2, atol=1e-6)
    # The answer may be the stronger, but the ball says how fast and how sharp the blow was.
    assert impact.speed == pytest.approx(8, rel=0.01)
    assert impact.radius == 0.2


@every_engine
def test_a_body_lies_on_a_turned_block(engine: str) -> None:
    """A block on its side, twice as high as wide; the bar falls on it and stays."""
    shape = builtin("bar")
    half = 0.5**0.5
    block = Block((0, 0, 1.0), (1.0, 0.5, 0.25), (half, 0.0, half, 0.0))  # its long side stands up
    scene = Scene((Placed("bar", "stone", (0, 0, 2.3)),), floor=Floor(), blocks=(block,), duration=4.0, engine=engine)
    recording = _run(scene, shape).recording
    tracks = {track.name: track for track in recording.tracks}
    assert tracks["shape0"].positions[-1][2] == pytest.approx(2.2, abs=0.01)
    drawn = tracks["block0"]
    assert drawn.kind == "block"
    assert (drawn.start, drawn.stop) == (0, recording.frames)
    corners = drawn.mesh.vertices @ rotation_matrix(drawn.quats_wxyz[-1]).T + drawn.positions[-1]
    np.testing.assert_allclose(np.abs(corners - [0, 0, 1.0]).max(axis=0), [0.25, 0.5, 1.0], atol=1e-9)


@every_engine
def test_both_balls_of_a_dual_scene_count(engine: str) -> None:
    shape = builtin("bar")
    left, right = Ball(0.1, 7800, (0.5, -1, 0), (0, 10, 0)), Ball(0.1, 7800, (-0.5, 1, 0), (0, -5, 0))
    scene = Scene((Placed("bar", "stone"),), (left, right), gravity=0.0, duration=1.0, engine=engine)
    both = joint_impact(scene, shape, materials=STONE)
    one = joint_impact(replace(scene, balls=(left,)), shape, materials=STONE)
    assert both is not None
    assert one is not None
    assert len(one.magnitude) == 1
    assert len(both.magnitude) == 2
    # The first keeps all that it had alone; the second, at half the speed, hits the other side later.
    assert both.magnitude[0] == one.magnitude[0]
    assert both.speed == one.speed
    assert both.direction[0] @ both.direction[1] < -0.8
    assert both.position[0, 0] > 0.4 and both.position[1, 0] < -0.3
    assert np.abs(signed_distance_points(shape.mesh, both.position)).max() < 1e-6


@every_engine
def test_a_ball_that_misses_leaves_the_other_alone(engine: str) -> None:
    shape = builtin("bar")
    hits, misses = Ball(0.1, 7800, (0, -1, 0), (0, 10, 0)), Ball(0.1, 7800, (0, 1, 3), (0, -10, 0))
    scene = Scene((Placed("bar", "stone"),), (hits, misses), gravity=0.0, duration=0.5, engine=engine)
    impact = joint_impact(scene, shape, materials=STONE)
    assert impact is not None
    assert len(impact.magnitude) == 1
    assert joint_impact(replace(scene, balls=(misses,)), shape, materials=STONE) is None


@every_engine
@pytest.mark.parametrize("name", ["bar", "mug"])
def test_shear_scenes_load_a_shape_between_ball_and_edge(engine: str, name: str) -> None:
    shape = builtin(name)
    answered = []
    for number in range(4):
        rng = np.random.default_rng(number)
        scene = draw_scene("shear", shape, rng, material="stone", speed=(6.0, 10.0), seed=0)
        impact = joint_impact(scene, shape, materials=STONE, engine=engine)
        assert impact is not None
        turn = rotation_matrix(np.array(scene.shapes[0].quat_wxyz))
        impulse = (impact.magnitude[:, None] * impact.direction) @ turn.T
        ball = int(np.argmin(impulse[:, 2]))
        answers = np.delete(impulse[:, 2], ball)
        assert impulse[ball, 2] < 0
        answered.append(answers[answers > 0].sum() / -impulse[ball, 2])
    assert 0.5 < np.median(answered) < 1.2


def _halver(asked: list[tuple[Shape, Impact]]) -> Callable[[Shape, Impact, np.random.Generator], Fragments]:
    """Cuts whatever it is asked about across its longest axis, and remembers."""

    def breaker(shape: Shape, impact: Impact, rng: np.random.Generator) -> Fragments:
        asked.append((shape, impact))
        normal = np.zeros(3)
        normal[np.argmax(np.ptp(shape.mesh.bounds, axis=0))] = 1.0
        return _pieces(shape.mesh, [(normal.tolist(), 0.03)])

    return breaker


@every_engine
@pytest.mark.parametrize("generations", [0, 1, 2])
def test_fragments_break_again_as_often_as_asked(engine: str, generations: int) -> None:
    """A bar falls flat; its halves break where they land again."""
    shape = builtin("bar")
    asked: list[tuple[Shape, Impact]] = []
    scene = Scene(
        (Placed("bar", "stone", (0, 0, 1.5), (0.966, 0, 0.2588, 0)),),
        floor=Floor(),
        duration=2.0,
        impulse_fraction=0.0,
        engine=engine,
        refracture=generations,
    )
    outcome = _run(scene, shape, _halver(asked))
    assert max(c.generation for c in outcome.breaks) == generations
    for struck, impact in asked:
        assert (struck.whole is None) == (struck.size == 1.0)
        np.testing.assert_allclose(np.ptp(struck.mesh.bounds, axis=0).max(), 2)
        assert np.abs(signed_distance_points(struck.mesh, impact.position)).max() < 1e-6
    # All pieces are in the frame of the whole and fill it, and none is lighter or heavier than it should be.
    left: dict[str, Fragment] = {}
    for collision in outcome.breaks:
        left.pop(collision.body, None)
        left |= {f"{collision.body}.{i:03d}": p for i, p in enumerate(collision.fragments or ())}
        assert collision.shape is shape
    assert sum(p.volume for p in left.values()) == pytest.approx(shape.mesh.volume, rel=1e-5)
    assert sum(p.mass for p in left.values()) == pytest.approx(_mass(shape).mass, rel=1e-5)
    centre = sum(p.mass * p.centre for p in left.values()) / _mass(shape).mass
    np.testing.assert_allclose(centre, _mass(shape).centre, atol=1e-5)
    tracks = {track.name: track for track in outcome.recording.tracks}
    assert {name for name, track in tracks.items() if track.stop == outcome.recording.frames} == {*left, "floor"}
    for collision in outcome.breaks:  # fragments of fragments start where what they come from was last
        if collision.generation and collision.body in tracks and tracks[collision.body].stop > 1:
            parent, child = tracks[collision.body], tracks[f"{collision.body}.000"]
            assert child.start == parent.stop
            assert np.linalg.norm(child.positions[0] - parent.positions[-1]) < 0.3


@every_engine
def test_breaking_again_conserves_momentum(engine: str) -> None:
    """In empty space: two balls, one after the other, and a bar whose half breaks again."""
    shape = builtin("bar")
    asked: list[tuple[Shape, Impact]] = []
    balls = (Ball(0.1, 7800, (0.4, -1, 0), (0, 8, 0)), Ball(0.1, 7800, (0.5, -2.5, 0), (0, 14, 0)))
    scene = Scene(
        (Placed("bar", "stone"),), balls, gravity=0.0, duration=0.5, engine=engine, refracture=1, restitution=0.0
    )
    outcome = _run(scene, shape, _halver(asked))
    assert max(c.generation for c in outcome.breaks) == 1
    masses = {
        f"{c.body}.{i:03d}": MassProperties(p.mass, p.centre, p.inertia)
        for c in outcome.breaks
        for i, p in enumerate(c.fragments or ())
    }
    solids = {f"ball{i}": MassProperties(b.mass, np.zeros(3), np.eye(3)) for i, b in enumerate(balls)}
    before = sum(np.array(ball.velocity) * ball.mass for ball in balls)
    after = np.zeros(3)
    for track in outcome.recording.tracks:
        if track.stop == outcome.recording.frames:
            mass = (masses | solids)[track.name]
            ends = [
                p + rotation_matrix(q) @ mass.centre
                for p, q in zip(track.positions[-2:], track.quats_wxyz[-2:], strict=True)
            ]
            after += mass.mass * (ends[1] - ends[0]) / outcome.recording.frame_time
    assert np.linalg.norm(after - before) < 0.01 * np.linalg.norm(before)


def test_crumbs_do_not_break_again() -> None:
    """What holds less than a fiftieth of the whole is never asked about."""
    shape = builtin("bar")
    asked: list[Shape] = []

    def breaker(struck: Shape, impact: Impact, rng: np.random.Generator) -> Fragments:
        asked.append(struck)
        return _pieces(struck.mesh, [([1.0, 0, 0], offset) for offset in np.linspace(-0.97, 0.97, 60)])

    scene = Scene((Placed("bar", "stone", (0, 0, 0.6)),), floor=Floor(), duration=1.5, refracture=3)
    outcome = _run(scene, shape, breaker)
    assert len(outcome.breaks[0].fragments or ()) > 50
    assert [struck.whole for struck in asked] == [None]
