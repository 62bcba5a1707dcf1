"""Bullet (pybullet) behind the engine seam: the engine of the paper.

Bodies are handed to it in principal axes about their centre of mass, as Bullet wants them. They are
plain rigid bodies (maximal coordinates) with split impulses: then a deep contact is resolved without
adding momentum, and an impulse is m dv to 1e-4; the default multi-bodies overshoot by 5 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from deepfracture.geometry.rotations import quat_from_matrix, quat_multiply, rotation_matrix
from deepfracture.runtime.extras import pip_command
from deepfracture.runtime.files import scratch_folder
from deepfracture.types import BadInput, Floats
from deepfracture.world.engine import FLOOR_DEPTH, FLOOR_REACH, ROLLING, TURNING, Contact, Mass, Motion, Surface

INSTANT = 1e-9
"""A step in which nothing happens [s]."""
SAME = 1 - 1e-9
"""Cosine of half the angle between orientations that are one."""
WARM = 0.85
"""Share of the impulses of a step that Bullet begins the next one with."""
REBOUND, PILE = 0.0005, 0.006
"""Bodies nearer than this are in contact [m]. Bullet brakes what is about to touch, and what it has braked
bounces less, so for impulses the distance is small; piles need contacts that last, so for them it is not."""


@dataclass(frozen=True, eq=False)
class _Frame:
    """Bullet's frame of a body: origin at the centre of mass, axes of inertia."""

    centre: Floats
    quat_wxyz: Floats
    """Rotation mesh_from_principal, shape (4,)."""


_CENTRED = _Frame(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


class Bullet:
    def __init__(self, gravity: float, surface: Surface) -> None:
        try:
            import pybullet
        except ImportError as error:
            raise BadInput(
                f"engine 'bullet' needs pybullet (Linux, Python <= 3.11: {pip_command('bullet')}); "
                "use engine 'rapier' instead"
            ) from error
        self._api: Any = pybullet
        self._client = pybullet.connect(pybullet.DIRECT)
        self._world = {"physicsClientId": self._client}
        pybullet.setGravity(0, 0, -gravity, **self._world)
        pybullet.setPhysicsEngineParameter(
            useSplitImpulse=1,
            splitImpulsePenetrationThreshold=0.0,
            restitutionVelocityThreshold=0.1,
            contactBreakingThreshold=REBOUND,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
            **self._world,
        )
        self._dt = 0.0
        self._fresh = False
        """Whether a body was added or turned since the last step: see `_turn_inertia`."""
        self._friction = float(np.sqrt(surface.friction))
        self._restitution = float(np.sqrt(surface.restitution))
        self._frames: dict[int, _Frame] = {}
        self._ids: dict[int, int] = {}
        """Bullet's number of each body; Bullet gives a number again once its body is gone, we do not."""
        self._bodies: dict[int, int] = {}
        self._opened = ExitStack()
        self._folder = self._opened.enter_context(scratch_folder())
        self._files = count()
        self._count = count()

    def add_body(self, hulls: Sequence[Floats], mass: Mass, motion: Motion) -> int:
        moments, axes = mass.principal()
        shape = self._shape([(hull - mass.centre) @ axes for hull in hulls])
        self._fresh = True
        return self._add(shape, mass.mass, moments, _Frame(mass.centre, quat_from_matrix(axes)), motion, TURNING)

    def add_ball(self, radius: float, mass: float, motion: Motion) -> int:
        shape = self._api.createCollisionShape(self._api.GEOM_SPHERE, radius=radius, **self._world)
        moments = np.full(3, 0.4 * mass * radius**2)
        return self._add(shape, mass, moments, _CENTRED, motion, ROLLING)

    def add_floor(self, height: float, friction: float) -> int:
        half = [FLOOR_REACH, FLOOR_REACH, FLOOR_DEPTH]
        shape = self._api.createCollisionShape(self._api.GEOM_BOX, halfExtents=half, **self._world)
        place = [0, 0, height - FLOOR_DEPTH]
        floor = self._api.createMultiBody(0, shape, basePosition=place, useMaximalCoordinates=1, **self._world)
        self._looks(floor, friction / self._friction)
        return self._keep(floor, _CENTRED)

    def add_block(self, half_sides: Floats, friction: float, motion: Motion) -> int:
        shape = self._api.createCollisionShape(self._api.GEOM_BOX, halfExtents=list(half_sides), **self._world)
        place, turn = _to_bullet(motion, _CENTRED)
        block = self._api.createMultiBody(
            0, shape, basePosition=place, baseOrientation=turn, useMaximalCoordinates=1, **self._world
        )
        self._looks(block, friction / self._friction)
        return self._keep(block, _CENTRED)

    def remove(self, body: int) -> None:
        del self._frames[body], self._bodies[self._ids[body]]
        self._api.removeBody(self._ids.pop(body), **self._world)

    def move(self, body: int, motion: Motion) -> None:
        place, turn = _to_bullet(motion, self._frames[body])
        held = self._ids[body]
        _, turned = self._api.getBasePositionAndOrientation(held, **self._world)
        self._fresh |= abs(np.dot(turn, turned)) < SAME
        self._api.resetBasePositionAndOrientation(held, place, turn, **self._world)
        self._api.resetBaseVelocity(held, list(motion.velocity), list(motion.spin), **self._world)

    def slow(self, body: int, factor: float) -> None:
        velocity, spin = self._api.getBaseVelocity(self._ids[body], **self._world)
        slower = [factor * v for v in velocity], [factor * w for w in spin]
        self._api.resetBaseVelocity(self._ids[body], *slower, **self._world)

    def prefer_piles(self) -> None:
        self._api.setPhysicsEngineParameter(contactBreakingThreshold=PILE, **self._world)

    def step(self, dt: float) -> None:
        if self._fresh:
            self._turn_inertia()
        if dt != self._dt:
            self._api.setPhysicsEngineParameter(fixedTimeStep=dt, **self._world)
            self._dt = dt
        self._api.stepSimulation(**self._world)

    def _turn_inertia(self) -> None:
        """Until its first step is over, Bullet turns a new body as if it had the inertia of its box and stood upright,
        whatever it was told since; one that was put elsewhere, as it stood before. So a step of no length goes first,
        in which nothing pushes and nothing moves."""
        known = self._api.getPhysicsEngineParameters(**self._world)
        self._api.setPhysicsEngineParameter(
            fixedTimeStep=INSTANT, numSolverIterations=0, warmStartingFactor=0.0, **self._world
        )
        self._api.stepSimulation(**self._world)
        self._api.setPhysicsEngineParameter(
            numSolverIterations=known["numSolverIterations"], warmStartingFactor=WARM, **self._world
        )
        self._dt, self._fresh = 0.0, False

    def motion(self, body: int) -> Motion:
        frame = self._frames[body]
        place, (x, y, z, w) = self._api.getBasePositionAndOrientation(self._ids[body], **self._world)
        velocity, spin = self._api.getBaseVelocity(self._ids[body], **self._world)
        quat = quat_multiply(np.array([w, x, y, z]), frame.quat_wxyz * [1, -1, -1, -1])
        origin = np.array(place) - rotation_matrix(quat) @ frame.centre
        return Motion(origin, quat, np.array(velocity), np.array(spin))

    def contacts(self, body: int, began: Motion) -> list[Contact]:
        found: list[Contact] = []
        for point in self._api.getContactPoints(bodyA=self._ids[body], **self._world):
            first, second = self._bodies[point[1]], self._bodies[point[2]]
            impulse = point[9] * self._dt  # Bullet reports a force
            if impulse > 0:
                push = 1.0 if first == body else -1.0  # the normal points from the second to the first
                place = point[5] if first == body else point[6]
                other = second if first == body else first
                found.append(Contact(other, np.array(place), push * np.array(point[7]), impulse))
        return sorted(found, key=lambda c: (c.other, -c.impulse, *c.position))

    def close(self) -> None:
        self._api.disconnect(**self._world)
        self._opened.close()

    def _add(self, shape: int, mass: float, moments: Floats, frame: _Frame, motion: Motion, damping: float) -> int:
        held = self._api.createMultiBody(mass, shape, useMaximalCoordinates=1, **self._world)
        self._looks(held, self._friction)
        # Mass and inertia in one call: Bullet's bodies turn NaN when only the inertia is given.
        self._api.changeDynamics(
            held,
            -1,
            mass=mass,
            localInertiaDiagonal=list(moments),
            linearDamping=0.0,
            angularDamping=1 - np.exp(-damping),  # Bullet: the share lost in a second
            **self._world,
        )
        body = self._keep(held, frame)
        self.move(body, motion)
        return body

    def _keep(self, held: int, frame: _Frame) -> int:
        body = next(self._count)
        self._ids[body], self._bodies[held], self._frames[body] = held, body, frame
        return body

    def _looks(self, held: int, friction: float) -> None:
        self._api.changeDynamics(held, -1, lateralFriction=friction, restitution=self._restitution, **self._world)

    def _shape(self, hulls: list[Floats]) -> int:
        if len(hulls) == 1:
            points = hulls[0].tolist()
            return self._api.createCollisionShape(self._api.GEOM_MESH, vertices=points, **self._world)
        # A file with one object a hull is pybullet's only way to a compound of hulls. It is read again when
        # the body is made, so it stays until the engine is closed.
        path = self._folder / f"{next(self._files)}.obj"
        path.write_text(_obj(hulls), encoding="ascii")
        return self._api.createCollisionShape(self._api.GEOM_MESH, fileName=str(path), **self._world)


def _to_bullet(motion: Motion, frame: _Frame) -> tuple[list[float], list[float]]:
    """Place of the centre of mass and orientation (x, y, z, w) of the principal axes."""
    w, x, y, z = quat_multiply(motion.quat_wxyz, frame.quat_wxyz)
    return list(motion.position + rotation_matrix(motion.quat_wxyz) @ frame.centre), [x, y, z, w]


def _obj(hulls: list[Floats]) -> str:
    from scipy.spatial import ConvexHull

    lines: list[str] = []
    start = 1
    for i, points in enumerate(hulls):
        lines.append(f"o hull{i}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
        lines += [f"f {a} {b} {c}" for a, b, c in ConvexHull(points, qhull_options="QJ").simplices + start]
        start += len(points)
    return "\n".join(lines) + "\n"
