"""The bodies of a scene inside an engine, and the collisions that they suffer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepfracture.geometry import mass_properties
from deepfracture.geometry.convex.hulls import piece_hulls, whole_hulls
from deepfracture.geometry.rotations import cross, rotation_matrix
from deepfracture.types import BadInput, Floats, Fragment, Fragments, Impact, Ints, Material, Mesh, Shape
from deepfracture.world.engine import Contact, Engine, Mass, Motion, Surface, open_engine
from deepfracture.world.footing import Footing
from deepfracture.world.impulse import FLOOR_RADIUS, LEAST_CLOSING, Party, Push, impact_of, totals
from deepfracture.world.pieces import HARDER, SAME_BLOW, SMALLEST_SHARE, as_shape
from deepfracture.world.rest import Rest
from deepfracture.world.scene import Ball, Block, Placed, Scene

TRAVEL = 0.125
"""A ball moves at most this many radii a step, so that it is met at the surface and not behind a wall."""
SHAPE_TRAVEL = 0.05
"""A falling shape, and a ball among fragments, move at most this far a step [m]: what a ball drives into the floor
would sink in as far."""
SINKING = 0.002
"""Nothing stands deeper in the floor than this at the end of a frame [m]; what merely lies there does not sink in so
far ..."""
THIN = 1e-4
"""... nor does the centre of mass of a flat shard come closer to it [m]."""

DROWSY_SPEED, DROWSY_SPIN = 0.3, 2.0
"""What is slower [m/s, rad/s], on a floor, is about to come to rest ..."""
DROWSINESS = 6.0
"""... and loses its velocities at this rate [1/s], as it would by the crumbling of its edges. Rigid bodies
would rock and spin on a point for very long."""
STRIKING = 1.0
"""A ball no faster than this breaks no fragment [m/s], where only balls may break them."""
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
    """None for balls, blocks and the floor, whose meshes the recording makes."""
    mass: Mass
    radius: float
    """Of curvature, where something touches it [m]."""
    shape: Shape | None = None
    """Only of what can break."""
    generation: int = 0
    """0 for a whole shape, one more than its parent's for a fragment."""
    source: Ints | None = None
    """Of a fragment: `Fragment.source`, in the whole."""
    born: float = 0.0
    """When it came to be [s]."""
    hulls: tuple[Floats, ...] = ()
    """Convex parts that stand for it in collisions, points in the mesh frame; none for balls and what is fixed."""

    @property
    def fixed(self) -> bool:
        return self.kind in ("floor", "block")


@dataclass(frozen=True, eq=False)
class Striker:
    """A moving body that struck another, and what that did to it."""

    body: Body
    before: Motion
    impulse: Floats
    """On the striker [N s], world frame, shape (3,)."""
    twist: Floats
    """Angular impulse on the striker about its own centre of mass [N m s], world frame, shape (3,)."""
    alone: bool
    """Whether it touched nothing else in that step."""


@dataclass(frozen=True, eq=False)
class Hit:
    """A breakable body was struck in the last step."""

    body: Body
    impact: Impact
    before: Motion
    after: Motion
    strikers: tuple[Striker, ...]


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
            self.bodies[number] = _fixed(number, "floor", "floor")
        for i, block in enumerate(scene.blocks):
            number = self.engine.add_block(np.asarray(block.half_sides), block.friction, block_motion(block))
            self.bodies[number] = _fixed(number, f"block{i}", "block")
        for i, (placed, shape) in enumerate(zip(scene.shapes, shapes, strict=True)):
            self._add_shape(f"shape{i}", placed, shape, materials)
        self._waiting = sorted(enumerate(scene.balls), key=lambda ball: (ball[1].delay, ball[0]))
        self._rest = Rest()
        self._withstood: dict[int, float] = {}
        """Strongest impulse that a fragment was asked about and did not break from [N s]."""
        self._footing = Footing()
        self._gone: set[int] = set()
        """Balls that are far from everything and flying away."""
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
        """Put the fragments in the place of what broke, as it was before the step that broke it.

        Each starts from v + omega x r of the whole, so the momentum of the whole is that of its fragments.
        With push = 1 (v, omega) is what the whole had after the collision; with less, the share that it has
        not taken goes back to the strikers, which then push the fragments that they meet. The whole and its
        strikers stand where they were before the contact: only there do the impulses balance the moments too.
        """
        share = self.scene.push
        for striker in hit.strikers:
            if striker.body.number in self.bodies:  # it may have broken in the same collision
                self._set_back(striker, share)
        whole = _between(hit.before, hit.after, share)
        self.remove(hit.body)
        turn = rotation_matrix(whole.quat_wxyz)
        hulls = piece_hulls([piece.mesh for piece in fragments])
        added = []
        for i, (piece, hull) in enumerate(zip(fragments, hulls, strict=True)):
            arm = turn @ (piece.centre - hit.body.mass.centre)
            velocity = whole.velocity + cross(whole.spin, arm)
            motion = Motion(whole.position, whole.quat_wxyz, velocity, whole.spin)
            mass = Mass(piece.mass, piece.centre, piece.inertia)
            number = self.engine.add_body(hull.points, mass, motion)
            name = f"{hit.body.name}.{i:03d}"
            generation = hit.body.generation + 1
            shape = self._breakable(piece, name, hit.body, generation)
            self.bodies[number] = Body(
                number,
                name,
                "fragment",
                piece.mesh,
                mass,
                1.0,
                shape,
                generation,
                piece.source,
                self.time,
                hull.points,
            )
            added.append(self.bodies[number])
        if not any(body.kind == "shape" for body in self.bodies.values()):
            self.engine.prefer_piles()
        return added

    def _set_back(self, striker: Striker, share: float) -> None:
        """Put a striker where it was before the contact, with a share of what the collision did to it.

        An engine may lose angular momentum in a contact, so what it made of the striker counts only where
        others have struck it too."""
        body, before = striker.body, striker.before
        turn = rotation_matrix(before.quat_wxyz)
        kick = striker.impulse / body.mass.mass
        turned = turn @ np.linalg.solve(body.mass.inertia, turn.T @ striker.twist)
        velocity, spin = before.velocity + share * kick, before.spin + share * turned
        if not striker.alone:
            now = self.engine.motion(body.number)
            velocity, spin = now.velocity + (share - 1) * kick, now.spin + (share - 1) * turned
        self.engine.move(body.number, Motion(before.position, before.quat_wxyz, velocity, spin))

    def _breakable(self, piece: Fragment, name: str, parent: Body, generation: int) -> Shape | None:
        """A fragment as a shape, if it is large and old enough a generation to break again."""
        assert parent.shape is not None
        whole = parent.shape.whole or parent.shape
        if generation > self.scene.refracture or piece.volume < SMALLEST_SHARE * whole.mesh.volume:
            return None
        return as_shape(piece, name, whole)

    def settle(self, moving: list[tuple[Body, Motion]], dt: float) -> bool:
        """Calm down what hardly moves, `dt` after the last time. Returns whether everything rests.

        Where there is something fixed to lie on, a body at rest is held still and a slow one loses its velocities."""
        everything = not self._waiting
        lying = any(body.fixed for body in self.bodies.values()) and self.scene.gravity > 0
        for body, motion in moving:
            rests = self._rest.update(body.number, motion, body.mass.centre, dt)
            leaves = body.kind == "ball" and self._leaves(motion, moving)
            (self._gone.add if leaves else self._gone.discard)(body.number)
            everything &= rests or leaves
            if lying and rests:
                self.engine.slow(body.number, 0.0)
            elif lying and _drowsy(body, motion):
                self.engine.slow(body.number, float(np.exp(-DROWSINESS * dt)))
        return everything

    def _leaves(self, ball: Motion, moving: list[tuple[Body, Motion]]) -> bool:
        """Whether a ball is far from everything that may still matter, and flying away."""
        apart = ball.position - np.array([m.position for body, m in moving if body.kind != "ball"])
        return bool((np.linalg.norm(apart, axis=1) > GONE).all() and (apart @ ball.velocity > 0).all())

    def expect(self, ball: Ball) -> None:
        """One more ball of the scene, the last in its list; it enters when its delay is over."""
        self._waiting.append((len(self.scene.balls), ball))
        self._waiting.sort(key=lambda waiting: (waiting[1].delay, waiting[0]))
        self.scene = replace(self.scene, balls=(*self.scene.balls, ball))

    def remove(self, body: Body) -> None:
        del self.bodies[body.number]
        self.engine.remove(body.number)

    def lift(self, moving: list[tuple[Body, Motion]]) -> list[tuple[Body, Motion]]:
        """Take out of the floor what has been pressed into it (see `SINKING`); returns where everything is then.

        Contacts of an engine yield, most of all where a heavy body presses a light one; the floor does not. Only places
        change, not velocities (post-stabilisation: Cline and Pai 2003), so nothing bounces because of it."""
        if self.scene.floor is None:
            return moving
        lowest, centres = self._footing.heights([body for body, _ in moving], [motion for _, motion in moving])
        floor = self.scene.floor.height
        ups = np.maximum(floor - lowest - SINKING, floor + THIN - centres)
        found = list(moving)
        for n in np.flatnonzero(ups > 0).tolist():
            body, motion = moving[n]
            found[n] = body, replace(motion, position=motion.position + np.array([0.0, 0.0, ups[n]]))
            self.engine.move(body.number, found[n][1])
        return found

    def moving(self) -> list[tuple[Body, Motion]]:
        return [(b, self.engine.motion(b.number)) for b in self.bodies.values() if not b.fixed]

    def _add_shape(self, name: str, placed: Placed, shape: Shape, materials: Mapping[str, Material]) -> None:
        if placed.material not in materials:
            raise BadInput(f"material must be one of {', '.join(materials)}, got {placed.material!r}")
        properties = mass_properties(shape.mesh, materials[placed.material].density)
        mass = Mass(properties.mass, properties.centre, properties.inertia)
        quat = np.asarray(placed.quat_wxyz) / np.linalg.norm(placed.quat_wxyz)
        motion = Motion(np.asarray(placed.position), quat, np.asarray(placed.velocity), np.asarray(placed.spin))
        hulls = whole_hulls(shape.mesh).points
        number = self.engine.add_body(hulls, mass, motion)
        self.bodies[number] = Body(number, name, "shape", shape.mesh, mass, 1.0, shape, hulls=hulls)

    def _enter_balls(self) -> None:
        while self._waiting and self._waiting[0][1].delay <= self.time + 1e-9:
            index, ball = self._waiting.pop(0)
            number = self.engine.add_ball(ball.radius, ball.mass, _start(ball))
            inertia = 0.4 * ball.mass * ball.radius**2 * np.eye(3)
            mass = Mass(ball.mass, np.zeros(3), inertia)
            self.bodies[number] = Body(number, f"ball{index}", "ball", None, mass, ball.radius, born=self.time)

    def _substeps(self, dt: float) -> int:
        """As many that nothing fast jumps into what it meets, until it leaves."""
        breakable = any(body.shape for body in self.bodies.values())
        need = 1.0
        for body in self.bodies.values():
            if body.kind == "shape" or (body.kind == "ball" and body.number not in self._gone):
                motion = self.engine.motion(body.number)
                reach = TRAVEL * body.radius if breakable and body.kind == "ball" else SHAPE_TRAVEL
                need = max(need, float(np.linalg.norm(motion.velocity)) * dt / reach)
        return int(np.ceil(need))

    def _substep(self, dt: float) -> list[Hit]:
        striking = self._striking()
        breakable = [body for body in self.bodies.values() if body.shape and self._may_break(body, striking)]
        before = {body.number: motion for body, motion in self.moving()} if breakable else {}
        self.engine.step(dt)
        if breakable and striking is not None:
            struck = {c.other for ball in striking for c in self.engine.contacts(ball.number, before[ball.number])}
            breakable = [body for body in breakable if body.generation == 0 or body.number in struck]
        hits = [self._hit(body, before, dt) for body in breakable]
        return [hit for hit in hits if hit and self._is_news(hit)]

    def _striking(self) -> list[Body] | None:
        """The balls that may break fragments; None: anything may."""
        if self.scene.again != "balls":
            return None
        balls = [body for body in self.bodies.values() if body.kind == "ball"]
        return [ball for ball in balls if np.linalg.norm(self.engine.motion(ball.number).velocity) > STRIKING]

    def _may_break(self, body: Body, striking: list[Body] | None) -> bool:
        if body.generation == 0:
            return True
        if striking is not None:
            return any(ball.born > body.born for ball in striking)
        return self.time - body.born > SAME_BLOW

    def _is_news(self, hit: Hit) -> bool:
        """Whether a blow says more than those before it (see `pieces.HARDER`)."""
        if hit.body.generation == 0:
            return True
        impulse = float(hit.impact.magnitude[0])
        if impulse <= HARDER * self._withstood.get(hit.body.number, 0.0):
            return False
        self._withstood[hit.body.number] = impulse
        return True

    def _hit(self, body: Body, before: dict[int, Motion], dt: float) -> Hit | None:
        contacts = self.engine.contacts(body.number, before[body.number])
        if not contacts:
            return None
        pushes = []
        for contact in contacts:
            speed = _speed_at(before[body.number], body, contact.position)
            other = self.bodies[contact.other]
            if not other.fixed:
                speed = speed - _speed_at(before[contact.other], other, contact.position)
            pushes.append(Push(contact, float(-speed @ contact.normal)))
        if max(push.closing for push in pushes) < LEAST_CLOSING:
            return None
        parties = {body.number: self._party(body, before, dt)}
        for number in sorted({push.contact.other for push in pushes}):
            if not self.bodies[number].fixed:
                parties[number] = self._party(self.bodies[number], before, dt)
        radii = {number: self.bodies[number].radius for number in {p.contact.other for p in pushes}}
        assert body.mesh is not None
        impact = impact_of(body.mesh, parties[body.number], pushes, parties, radii)
        if impact is None:
            return None
        own = parties.pop(body.number)
        return Hit(body, impact, own.before, own.after, self._strikers(body, own, pushes, parties))

    def _strikers(self, body: Body, own: Party, pushes: list[Push], parties: dict[int, Party]) -> tuple[Striker, ...]:
        """The moving bodies among what struck, each with its part of what the struck body gained, reversed.

        An engine's contacts say nothing of friction, so what they lack of the momentum and the spin that the body
        has got is shared by the size of the impulses. With one striker nothing is guessed."""
        each = totals(own, pushes, parties)
        turn, middle = rotation_matrix(own.before.quat_wxyz), _centre(own.before, body)
        sizes = {n: float(np.linalg.norm(impulse)) for n, impulse in each.items()}
        lack = own.gained - sum(each.values(), np.zeros(3))
        each = {n: impulse + lack * (sizes[n] / sum(sizes.values())) for n, impulse in each.items()}
        places = {n: _middle([push.contact for push in pushes if push.contact.other == n]) for n in each}
        twist = turn @ body.mass.inertia @ turn.T @ (own.after.spin - own.before.spin)
        twist = twist - sum((cross(places[n] - middle, impulse) for n, impulse in each.items()), np.zeros(3))
        found = []
        for n, party in parties.items():
            arm = places[n] - _centre(party.before, self.bodies[n])
            about = cross(arm, each[n]) + twist * (sizes[n] / sum(sizes.values()))
            alone = all(contact.other == body.number for contact in self.engine.contacts(n, party.before))
            found.append(Striker(self.bodies[n], party.before, -each[n], -about, alone))
        return tuple(found)

    def _party(self, body: Body, before: dict[int, Motion], dt: float) -> Party:
        after = self.engine.motion(body.number)
        weight = np.array([0.0, 0.0, -body.mass.mass * self.scene.gravity * dt])
        gained = body.mass.mass * (after.velocity - before[body.number].velocity) - weight
        return Party(before[body.number], after, gained, body.kind == "ball")


def _drowsy(body: Body, motion: Motion) -> bool:
    """Whether it is about to come to rest: slow, and not spinning unless it is a ball."""
    slow = np.linalg.norm(motion.velocity) < DROWSY_SPEED
    return bool(slow and (body.kind == "ball" or np.linalg.norm(motion.spin) < DROWSY_SPIN))


def _fixed(number: int, name: str, kind: str) -> Body:
    return Body(number, name, kind, None, Mass(np.inf, np.zeros(3), np.eye(3)), FLOOR_RADIUS)


def block_motion(block: Block) -> Motion:
    """Where a block stays."""
    quat = np.asarray(block.quat_wxyz) / np.linalg.norm(block.quat_wxyz)
    return Motion(np.asarray(block.position), quat, np.zeros(3), np.zeros(3))


def _start(ball: Ball) -> Motion:
    still = np.array([1.0, 0.0, 0.0, 0.0])
    return Motion(np.asarray(ball.position), still, np.asarray(ball.velocity), np.zeros(3))


def _between(before: Motion, after: Motion, share: float) -> Motion:
    """Where the body was before, with `share` of what the collision did to its velocities."""
    return Motion(
        before.position,
        before.quat_wxyz,
        before.velocity + share * (after.velocity - before.velocity),
        before.spin + share * (after.spin - before.spin),
    )


def _speed_at(motion: Motion, body: Body, point: np.ndarray) -> np.ndarray:
    """Velocity of the body's material at a point of the world."""
    return motion.velocity + cross(motion.spin, point - _centre(motion, body))


def _centre(motion: Motion, body: Body) -> Floats:
    """Centre of mass of a body in the world."""
    return motion.position + rotation_matrix(motion.quat_wxyz) @ body.mass.centre


def _middle(contacts: list[Contact]) -> Floats:
    """Where the contacts of one striker push, in the mean [m]."""
    weights = np.array([contact.impulse for contact in contacts])
    return weights @ np.array([contact.position for contact in contacts]) / weights.sum()
