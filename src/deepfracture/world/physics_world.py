"""The rigid bodies of a scene in an engine: they enter, move, collide, get replaced and come to rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from deepfracture.geometry import MassProperties, mass_properties
from deepfracture.geometry.convex.hulls import fragment_hulls, shape_hulls
from deepfracture.types import BadInput, Fragments, Material, Shape
from deepfracture.world.collisions import CollisionEvent, Step, collision_event
from deepfracture.world.engine import BodyState, Engine
from deepfracture.world.engines import open_engine
from deepfracture.world.floor_penetration import FloorPenetration
from deepfracture.world.refracture import RefractureFilter
from deepfracture.world.replacement import broken_state, fragment_state, striker_state
from deepfracture.world.rigid_body import RigidBody, ball_body, ball_state, block_state, fixed_body
from deepfracture.world.scene import Ball, Placed, Scene
from deepfracture.world.sleeping import SleepTracker

MAX_BALL_TRAVEL = 0.125
"""A ball moves at most this many radii a step, so that it meets the surface of a thin wall and not its back."""
MAX_TRAVEL = 0.05
"""A falling shape, and a ball among fragments, move at most this far a step [m]: what a ball drives into the floor
would sink in as far."""
DAMPED_SPEED, DAMPED_ANGULAR_SPEED = 0.3, 2.0
"""A slower body [m/s, rad/s], on a floor, is about to come to rest ..."""
SLEEP_DAMPING = 6.0
"""... and loses its velocities at this rate [1/s], as it would by the crumbling of its edges. Rigid bodies
would rock and spin on a point for very long."""
MIN_BALL_SPEED = 1.0
"""A slower ball breaks no fragment [m/s], where only balls may break them."""
ESCAPE_DISTANCE = 4.0
"""The simulation does not wait for a ball that is further than this from everything and moving away [m]."""


class PhysicsWorld:
    """Adds, removes and steps bodies; knows nothing of breaking or recording."""

    def __init__(self, scene: Scene, shapes: Sequence[Shape], materials: Mapping[str, Material]) -> None:
        if len(shapes) != len(scene.shapes):
            raise BadInput(f"the scene has {len(scene.shapes)} shapes, got {len(shapes)} meshes")
        self.scene = scene
        self.bodies: dict[int, RigidBody] = {}
        self.engine: Engine = open_engine(scene.engine, gravity=scene.gravity, contact=scene.contact_material)
        if scene.floor is not None:
            number = self.engine.add_floor(scene.floor.height, scene.floor.friction)
            self.bodies[number] = fixed_body(number, "floor", "floor")
        for i, block in enumerate(scene.blocks):
            number = self.engine.add_block(np.asarray(block.half_sides), block.friction, block_state(block))
            self.bodies[number] = fixed_body(number, f"block{i}", "block")
        for i, (placed, shape) in enumerate(zip(scene.shapes, shapes, strict=True)):
            self._add_shape(f"shape{i}", placed, shape, materials)
        self._queued_balls = sorted(enumerate(scene.balls), key=lambda ball: (ball[1].delay, ball[0]))
        self._sleep = SleepTracker()
        self._refracture = RefractureFilter(scene)
        self._floor = None if scene.floor is None else FloorPenetration(scene.floor.height)
        self._escaped: set[int] = set()
        """Balls that are far from everything and moving away."""
        self.time = 0.0
        self._enter_balls()

    def close(self) -> None:
        self.engine.close()

    def step(self) -> Iterator[CollisionEvent]:
        """One step of the scene, in as many steps of the engine as fast bodies need.

        Yields collisions as they happen; the caller may replace what broke before time goes on."""
        count = self._substeps(1 / self.scene.steps_per_second)
        dt = 1 / self.scene.steps_per_second / count
        for _ in range(count):
            self.time += dt
            yield from self._substep(dt)
        self._enter_balls()

    def replace(self, event: CollisionEvent, fragments: Fragments) -> list[RigidBody]:
        """Put fragments in the place of the body that broke (see `world.replacement`)."""
        fraction, body = self.scene.impulse_fraction, event.body
        for striker in event.strikers:
            number = striker.body.number
            if number in self.bodies:  # it may have broken in the same collision
                self.engine.set_state(number, striker_state(striker, self.engine.state(number), fraction))
        broken = broken_state(event, fraction)
        self.remove(body)
        assert body.whole is not None
        generation = body.generation + 1
        hulls = fragment_hulls([fragment.mesh for fragment in fragments])
        added = []
        for i, (fragment, hull) in enumerate(zip(fragments, hulls, strict=True)):
            name = f"{body.name}.{i:03d}"
            mass = MassProperties(fragment.mass, fragment.centre, fragment.inertia)
            number = self.engine.add_body(hull.points, mass, fragment_state(event, broken, fragment))
            self.bodies[number] = RigidBody(
                number, name, "fragment", mass, fragment.mesh, hulls=hull.points,
                shape=self._refracture.shape(fragment, name, body.whole, generation), whole=body.whole,
                generation=generation, source=fragment.source, created=self.time,
            )  # fmt: skip
            added.append(self.bodies[number])
        if not any(other.kind == "shape" for other in self.bodies.values()):
            self.engine.prefer_stacking()
        return added

    def queue_ball(self, ball: Ball) -> None:
        """Append a ball to the scene; it enters when its delay is over."""
        self._queued_balls.append((len(self.scene.balls), ball))
        self._queued_balls.sort(key=lambda queued: (queued[1].delay, queued[0]))
        self.scene = replace(self.scene, balls=(*self.scene.balls, ball))

    def remove(self, body: RigidBody) -> None:
        del self.bodies[body.number]
        self.engine.remove(body.number)

    def moving(self) -> list[tuple[RigidBody, BodyState]]:
        """All bodies that are not fixed."""
        return [(body, self.engine.state(body.number)) for body in self.bodies.values() if not body.fixed]

    def depenetrate(self, moving: list[tuple[RigidBody, BodyState]]) -> list[tuple[RigidBody, BodyState]]:
        """Raise bodies that penetrate the floor (see `PENETRATION_SLOP`); returns the states that then hold.

        Contacts of an engine yield, most of all where a heavy body presses a light one; the floor does not. Only
        positions change, not velocities (post-stabilisation: Cline and Pai 2003), so nothing bounces because of it."""
        if self._floor is None:
            return moving
        rises = self._floor.corrections([body for body, _ in moving], [state for _, state in moving])
        found = list(moving)
        for n in np.flatnonzero(rises > 0).tolist():
            body, state = moving[n]
            found[n] = body, replace(state, position=state.position + np.array([0.0, 0.0, rises[n]]))
            self.engine.set_state(body.number, found[n][1])
        return found

    def settle(self, moving: list[tuple[RigidBody, BodyState]], dt: float) -> bool:
        """Damp what is about to come to rest, `dt` [s] after the last call. Returns whether everything is at rest.

        Where there is something fixed to lie on, a body at rest is stopped and a slow one damped."""
        everything = not self._queued_balls
        supported = any(body.fixed for body in self.bodies.values()) and self.scene.gravity > 0
        for body, state in moving:
            sleeps = self._sleep.update(body.number, state, body.mass.centre, dt)
            escapes = body.kind == "ball" and _escapes(state, moving)
            (self._escaped.add if escapes else self._escaped.discard)(body.number)
            everything &= sleeps or escapes
            if supported and sleeps:
                self.engine.scale_velocity(body.number, 0.0)
            elif supported and _is_slow(body, state):
                self.engine.scale_velocity(body.number, float(np.exp(-SLEEP_DAMPING * dt)))
        return everything

    def _add_shape(self, name: str, placed: Placed, shape: Shape, materials: Mapping[str, Material]) -> None:
        if placed.material not in materials:
            raise BadInput(f"material must be one of {', '.join(materials)}, got {placed.material!r}")
        mass = mass_properties(shape.mesh, materials[placed.material].density)
        quat = np.asarray(placed.quat_wxyz) / np.linalg.norm(placed.quat_wxyz)
        position, velocity = np.asarray(placed.position), np.asarray(placed.velocity)
        state = BodyState(position, quat, velocity, np.asarray(placed.angular_velocity))
        hulls = shape_hulls(shape.mesh).points
        number = self.engine.add_body(hulls, mass, state)
        self.bodies[number] = RigidBody(number, name, "shape", mass, shape.mesh, hulls=hulls, shape=shape, whole=shape)

    def _enter_balls(self) -> None:
        while self._queued_balls and self._queued_balls[0][1].delay <= self.time + 1e-9:
            index, ball = self._queued_balls.pop(0)
            number = self.engine.add_ball(ball.radius, ball.mass, ball_state(ball))
            self.bodies[number] = ball_body(number, f"ball{index}", ball, self.time)

    def _substeps(self, dt: float) -> int:
        """So many that nothing fast tunnels into what it meets."""
        breakable = any(body.shape for body in self.bodies.values())
        need = 1.0
        for body in self.bodies.values():
            if body.kind == "shape" or (body.kind == "ball" and body.number not in self._escaped):
                travel = MAX_BALL_TRAVEL * body.radius if breakable and body.kind == "ball" else MAX_TRAVEL
                need = max(need, float(np.linalg.norm(self.engine.state(body.number).velocity)) * dt / travel)
        return int(np.ceil(need))

    def _substep(self, dt: float) -> list[CollisionEvent]:
        balls_only = self.scene.refracture_by == "balls"
        balls = self._fast_balls() if balls_only else []
        breakable = [b for b in self.bodies.values() if b.shape and self._refracture.may_break(b, balls, self.time)]
        before = {body.number: state for body, state in self.moving()} if breakable else {}
        self.engine.step(dt)
        step = Step(self.engine, self.bodies, before, self.scene.gravity, dt)
        if breakable and balls_only:
            struck = {contact.other for ball in balls for contact in step.contacts(ball.number)}
            breakable = [body for body in breakable if body.generation == 0 or body.number in struck]
        events = [collision_event(step, body) for body in breakable]
        return [event for event in events if event and self._refracture.is_stronger(event)]

    def _fast_balls(self) -> list[RigidBody]:
        balls = [body for body in self.bodies.values() if body.kind == "ball"]
        return [b for b in balls if np.linalg.norm(self.engine.state(b.number).velocity) > MIN_BALL_SPEED]


def _is_slow(body: RigidBody, state: BodyState) -> bool:
    """Whether a body is about to come to rest: slow, and not spinning unless it is a ball."""
    slow = np.linalg.norm(state.velocity) < DAMPED_SPEED
    return bool(slow and (body.kind == "ball" or np.linalg.norm(state.angular_velocity) < DAMPED_ANGULAR_SPEED))


def _escapes(ball: BodyState, moving: list[tuple[RigidBody, BodyState]]) -> bool:
    """Whether a ball is far from everything that may still matter, and moving away."""
    apart = ball.position - np.array([state.position for body, state in moving if body.kind != "ball"])
    return bool((np.linalg.norm(apart, axis=1) > ESCAPE_DISTANCE).all() and (apart @ ball.velocity > 0).all())
