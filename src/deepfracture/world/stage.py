"""The bodies of a scene inside an engine, and the collisions that they suffer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deepfracture.geometry import mass_properties
from deepfracture.types import BadInput, Fragments, Impact, Material, Mesh, Shape
from deepfracture.world.engine import Engine, Mass, Motion, Surface, cross, open_engine, rotation
from deepfracture.world.hulls import piece_hulls, whole_hulls
from deepfracture.world.impulse import FLOOR_RADIUS, LEAST_CLOSING, Party, Push, impact_of
from deepfracture.world.rest import Rest
from deepfracture.world.scene import Ball, Placed, Scene

TRAVEL = 0.125
"""A ball moves at most this many radii a step, so that it is met at the surface and not behind a wall."""
SHAPE_TRAVEL = 0.05
"""A falling shape moves at most this far a step [m]."""

DROWSY_SPEED, DROWSY_SPIN = 0.3, 2.0
"""What is slower [m/s, rad/s], on a floor, is about to come to rest ..."""
DROWSINESS = 6.0
"""... and loses its velocities at this rate [1/s], as it would by the crumbling of its edges. Rigid bodies
would rock and spin on a point for very long."""
GONE = 4.0
"""A ball further than this from everything, and leaving, is not waited for [m]."""


@dataclass(frozen=True, eq=False)
class Body:
    """One body on the stage."""

    number: int
    name: str
    kind: str
    """As in `types.Track`."""
    mesh: Mesh | None
    """None for balls and the floor, whose meshes the recording makes."""
    mass: Mass
    radius: float
    """Of curvature, where something touches it [m]."""
    shape: Shape | None = None
    """Only of what can break."""


@dataclass(frozen=True, eq=False)
class Hit:
    """A breakable body was struck in the last step."""

    body: Body
    impact: Impact
    before: Motion
    after: Motion
    strikers: tuple[tuple[Body, Motion, Motion], ...]
    """The moving bodies that struck, with their motion before and after."""


class Stage:
    """Adds, removes and steps bodies; knows nothing of breaking or recording."""

    def __init__(self, scene: Scene, shapes: Sequence[Shape], materials: Mapping[str, Material]) -> None:
        if len(shapes) != len(scene.shapes):
            raise BadInput(f"the scene has {len(scene.shapes)} shapes, got {len(shapes)} meshes")
        self.scene = scene
        self.bodies: dict[int, Body] = {}
        surface = Surface(scene.friction, scene.restitution)
        self.engine: Engine = open_engine(scene.engine, gravity=scene.gravity, surface=surface)
        if scene.floor is not None:
            number = self.engine.add_floor(scene.floor.height, scene.floor.friction)
            nothing = Mass(np.inf, np.zeros(3), np.eye(3))
            self.bodies[number] = Body(number, "floor", "floor", None, nothing, FLOOR_RADIUS)
        for i, (placed, shape) in enumerate(zip(scene.shapes, shapes, strict=True)):
            self._add_shape(f"shape{i}", placed, shape, materials)
        self._waiting = sorted(enumerate(scene.balls), key=lambda ball: (ball[1].delay, ball[0]))
        self._rest = Rest()
        self.time = 0.0
        self._enter_balls()

    def close(self) -> None:
        self.engine.close()

    def step(self) -> Iterator[Hit]:
        """One step of the scene, in as many steps of the engine as fast bodies need.

        Collisions come as they happen; what the caller does about one is done before time goes on."""
        count = self._substeps(1 / self.scene.steps_per_second)
        dt = 1 / self.scene.steps_per_second / count
        for _ in range(count):
            self.time += dt
            yield from self._substep(dt)
        self._enter_balls()

    def shatter(self, hit: Hit, fragments: Fragments) -> list[Body]:
        """Put the fragments in the place of what broke.

        Each starts from v + omega x r of the whole, so the momentum of the whole is that of its fragments.
        With push = 1 (v, omega) is what the whole had after the collision; with less, the share that it has
        not taken goes back to the strikers, which then push the fragments that they meet.
        """
        share = self.scene.push
        whole = _between(hit.before, hit.after, share)
        for striker, before, after in hit.strikers:
            if striker.number in self.bodies:  # it may have broken in the same collision
                self.engine.move(striker.number, _between(before, after, share))
        self.remove(hit.body)
        turn = rotation(whole.quat_wxyz)
        hulls = piece_hulls([piece.mesh for piece in fragments])
        added = []
        for i, (piece, hull) in enumerate(zip(fragments, hulls, strict=True)):
            arm = turn @ (piece.centre - hit.body.mass.centre)
            velocity = whole.velocity + cross(whole.spin, arm)
            motion = Motion(whole.position, whole.quat_wxyz, velocity, whole.spin)
            mass = Mass(piece.mass, piece.centre, piece.inertia)
            number = self.engine.add_body(hull.points, mass, motion)
            name = f"{hit.body.name}.{i:03d}"
            self.bodies[number] = Body(number, name, "fragment", piece.mesh, mass, 1.0)
            added.append(self.bodies[number])
        if not any(body.shape for body in self.bodies.values()):
            self.engine.prefer_piles()
        return added

    def settle(self, moving: list[tuple[Body, Motion]], dt: float) -> bool:
        """Calm down what hardly moves, `dt` after the last time. Returns whether everything rests.

        Where there is a floor to lie on, a body at rest is held still and a slow one loses its velocities."""
        everything = not self._waiting
        lying = self.scene.floor is not None and self.scene.gravity > 0
        for body, motion in moving:
            rests = self._rest.update(body.number, motion, body.mass.centre, dt)
            everything &= rests or (body.kind == "ball" and self._leaves(motion, moving))
            slow = np.linalg.norm(motion.velocity) < DROWSY_SPEED
            calm = body.kind == "ball" or np.linalg.norm(motion.spin) < DROWSY_SPIN
            if lying and rests:
                self.engine.slow(body.number, 0.0)
            elif lying and slow and calm:
                self.engine.slow(body.number, float(np.exp(-DROWSINESS * dt)))
        return everything

    def _leaves(self, ball: Motion, moving: list[tuple[Body, Motion]]) -> bool:
        """Whether a ball is far from everything that may still matter, and flying away."""
        apart = ball.position - np.array([m.position for body, m in moving if body.kind != "ball"])
        return bool((np.linalg.norm(apart, axis=1) > GONE).all() and (apart @ ball.velocity > 0).all())

    def remove(self, body: Body) -> None:
        del self.bodies[body.number]
        self.engine.remove(body.number)

    def moving(self) -> list[tuple[Body, Motion]]:
        return [(b, self.engine.motion(b.number)) for b in self.bodies.values() if b.kind != "floor"]

    def _add_shape(self, name: str, placed: Placed, shape: Shape, materials: Mapping[str, Material]) -> None:
        if placed.material not in materials:
            raise BadInput(f"material must be one of {', '.join(materials)}, got {placed.material!r}")
        properties = mass_properties(shape.mesh, materials[placed.material].density)
        mass = Mass(properties.mass, properties.centre, properties.inertia)
        quat = np.asarray(placed.quat_wxyz) / np.linalg.norm(placed.quat_wxyz)
        motion = Motion(np.asarray(placed.position), quat, np.asarray(placed.velocity), np.asarray(placed.spin))
        number = self.engine.add_body(whole_hulls(shape.mesh).points, mass, motion)
        self.bodies[number] = Body(number, name, "shape", shape.mesh, mass, 1.0, shape)

    def _enter_balls(self) -> None:
        while self._waiting and self._waiting[0][1].delay <= self.time + 1e-9:
            index, ball = self._waiting.pop(0)
            number = self.engine.add_ball(ball.radius, ball.mass, _start(ball))
            inertia = 0.4 * ball.mass * ball.radius**2 * np.eye(3)
            mass = Mass(ball.mass, np.zeros(3), inertia)
            self.bodies[number] = Body(number, f"ball{index}", "ball", None, mass, ball.radius)

    def _substeps(self, dt: float) -> int:
        """As many that nothing fast jumps into a wall, while there is something to break."""
        if not any(body.shape for body in self.bodies.values()):
            return 1
        need = 1.0
        for body, motion in self.moving():
            if body.kind != "fragment":
                reach = TRAVEL * body.radius if body.kind == "ball" else SHAPE_TRAVEL
                need = max(need, float(np.linalg.norm(motion.velocity)) * dt / reach)
        return int(np.ceil(need))

    def _substep(self, dt: float) -> list[Hit]:
        breakable = [body for body in self.bodies.values() if body.shape]
        before = {body.number: motion for body, motion in self.moving()} if breakable else {}
        self.engine.step(dt)
        hits = [self._hit(body, before, dt) for body in breakable]
        return [hit for hit in hits if hit]

    def _hit(self, body: Body, before: dict[int, Motion], dt: float) -> Hit | None:
        contacts = self.engine.contacts(body.number, before[body.number])
        if not contacts:
            return None
        pushes = []
        for contact in contacts:
            speed = _speed_at(before[body.number], body, contact.position)
            other = self.bodies[contact.other]
            if other.kind != "floor":
                speed = speed - _speed_at(before[contact.other], other, contact.position)
            pushes.append(Push(contact, float(-speed @ contact.normal)))
        if max(push.closing for push in pushes) < LEAST_CLOSING:
            return None
        parties = {body.number: self._party(body, before, dt)}
        for number in sorted({push.contact.other for push in pushes}):
            if self.bodies[number].kind != "floor":
                parties[number] = self._party(self.bodies[number], before, dt)
        radii = {number: self.bodies[number].radius for number in {p.contact.other for p in pushes}}
        assert body.shape is not None
        impact = impact_of(body.shape.mesh, parties[body.number], pushes, parties, radii)
        strikers = tuple((self.bodies[n], p.before, p.after) for n, p in parties.items() if n != body.number)
        own = parties[body.number]
        return Hit(body, impact, own.before, own.after, strikers)

    def _party(self, body: Body, before: dict[int, Motion], dt: float) -> Party:
        after = self.engine.motion(body.number)
        weight = np.array([0.0, 0.0, -body.mass.mass * self.scene.gravity * dt])
        gained = body.mass.mass * (after.velocity - before[body.number].velocity) - weight
        return Party(before[body.number], after, gained, body.kind == "ball")


def _start(ball: Ball) -> Motion:
    still = np.array([1.0, 0.0, 0.0, 0.0])
    return Motion(np.asarray(ball.position), still, np.asarray(ball.velocity), np.zeros(3))


def _between(before: Motion, after: Motion, share: float) -> Motion:
    """Where the body is after, with `share` of what the collision did to its velocities."""
    return Motion(
        after.position,
        after.quat_wxyz,
        before.velocity + share * (after.velocity - before.velocity),
        before.spin + share * (after.spin - before.spin),
    )


def _speed_at(motion: Motion, body: Body, point: np.ndarray) -> np.ndarray:
    """Velocity of the body's material at a point of the world."""
    centre = motion.position + rotation(motion.quat_wxyz) @ body.mass.centre
    return motion.velocity + cross(motion.spin, point - centre)
