"""Bullet (pybullet), the engine of the paper.

Its bodies have their frame at the centre of mass, along the principal axes. They are plain rigid bodies (maximal
coordinates) with split impulses: a deep contact is then resolved without adding momentum, and an impulse is m dv
to 1e-4; the default multi-bodies overshoot by 5 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from deepfracture.geometry import MassProperties
from deepfracture.geometry.rotations import quat_from_matrix, quat_multiply, rotation_matrix
from deepfracture.runtime.extras import pip_command
from deepfracture.runtime.files import scratch_folder
from deepfracture.types import BadInput, ContactMaterial, Floats
from deepfracture.world.engine import ANGULAR_DAMPING, BALL_ANGULAR_DAMPING, FLOOR_HALF_SIDES, BodyState, ContactPoint

NULL_STEP = 1e-9
"""A step in which nothing happens [s]."""
SAME_ORIENTATION = 1 - 1e-9
"""Cosine of half the angle below which two orientations are the same."""
WARM_STARTING = 0.85
"""Share of the impulses of a step that start the next one."""
REBOUND_DISTANCE, STACKING_DISTANCE = 0.0005, 0.006
"""Bodies nearer than this are in contact [m]. Bullet slows bodies that are about to touch, and what it has slowed
bounces less, so for impulses the distance is small; stacks need contacts that last, so for them it is larger."""


@dataclass(frozen=True, eq=False)
class _Frame:
    """Bullet's frame of a body: origin at the centre of mass, axes of inertia."""

    centre: Floats
    quat_wxyz: Floats
    """Rotation mesh_from_principal, shape (4,)."""


_CENTRED = _Frame(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


class Bullet:
    def __init__(self, gravity: float, contact: ContactMaterial) -> None:
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
            contactBreakingThreshold=REBOUND_DISTANCE,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
            **self._world,
        )
        self._dt = 0.0
        self._inertia_stale = False
        """Whether a body was added or turned since the last step: see `_refresh_inertia`."""
        self._friction = float(np.sqrt(contact.friction))
        self._restitution = float(np.sqrt(contact.restitution))
        self._frames: dict[int, _Frame] = {}
        self._ids: dict[int, int] = {}
        """Bullet's number of each body; Bullet reuses the numbers of removed bodies, the seam does not."""
        self._bodies: dict[int, int] = {}
        self._opened = ExitStack()
        self._folder = self._opened.enter_context(scratch_folder())
        self._files = count()
        self._count = count()

    def add_body(self, hulls: Sequence[Floats], mass: MassProperties, state: BodyState) -> int:
        moments, axes = mass.principal()
        shape = self._shape([(hull - mass.centre) @ axes for hull in hulls])
        self._inertia_stale = True
        return self._add(shape, mass.mass, moments, _Frame(mass.centre, quat_from_matrix(axes)), state, ANGULAR_DAMPING)

    def add_ball(self, radius: float, mass: float, state: BodyState) -> int:
        shape = self._api.createCollisionShape(self._api.GEOM_SPHERE, radius=radius, **self._world)
        moments = np.full(3, 0.4 * mass * radius**2)
        return self._add(shape, mass, moments, _CENTRED, state, BALL_ANGULAR_DAMPING)

    def add_floor(self, height: float, friction: float) -> int:
        half = list(FLOOR_HALF_SIDES)
        shape = self._api.createCollisionShape(self._api.GEOM_BOX, halfExtents=half, **self._world)
        position = [0, 0, height - FLOOR_HALF_SIDES[2]]
        floor = self._api.createMultiBody(0, shape, basePosition=position, useMaximalCoordinates=1, **self._world)
        self._set_contact(floor, friction / self._friction)
        return self._register(floor, _CENTRED)

    def add_block(self, half_sides: Floats, friction: float, state: BodyState) -> int:
        shape = self._api.createCollisionShape(self._api.GEOM_BOX, halfExtents=list(half_sides), **self._world)
        position, orientation = _to_bullet(state, _CENTRED)
        block = self._api.createMultiBody(
            0, shape, basePosition=position, baseOrientation=orientation, useMaximalCoordinates=1, **self._world
        )
        self._set_contact(block, friction / self._friction)
        return self._register(block, _CENTRED)

    def remove(self, body: int) -> None:
        del self._frames[body], self._bodies[self._ids[body]]
        self._api.removeBody(self._ids.pop(body), **self._world)

    def set_state(self, body: int, state: BodyState) -> None:
        position, orientation = _to_bullet(state, self._frames[body])
        handle = self._ids[body]
        _, former = self._api.getBasePositionAndOrientation(handle, **self._world)
        self._inertia_stale |= abs(np.dot(orientation, former)) < SAME_ORIENTATION
        self._api.resetBasePositionAndOrientation(handle, position, orientation, **self._world)
        self._api.resetBaseVelocity(handle, list(state.velocity), list(state.angular_velocity), **self._world)

    def scale_velocity(self, body: int, factor: float) -> None:
        velocity, angular_velocity = self._api.getBaseVelocity(self._ids[body], **self._world)
        slower = [factor * v for v in velocity], [factor * w for w in angular_velocity]
        self._api.resetBaseVelocity(self._ids[body], *slower, **self._world)

    def prefer_stacking(self) -> None:
        self._api.setPhysicsEngineParameter(contactBreakingThreshold=STACKING_DISTANCE, **self._world)

    def step(self, dt: float) -> None:
        if self._inertia_stale:
            self._refresh_inertia()
        if dt != self._dt:
            self._api.setPhysicsEngineParameter(fixedTimeStep=dt, **self._world)
            self._dt = dt
        self._api.stepSimulation(**self._world)

    def _refresh_inertia(self) -> None:
        """Update the inertia tensors in the world frame, which Bullet does only at the end of a step.

        In its first step a new body would turn as if it had the inertia of its bounding box and stood upright, and one
        whose state was set as it stood before. A step of no length, in which nothing moves, updates them."""
        former = self._api.getPhysicsEngineParameters(**self._world)
        self._api.setPhysicsEngineParameter(
            fixedTimeStep=NULL_STEP, numSolverIterations=0, warmStartingFactor=0.0, **self._world
        )
        self._api.stepSimulation(**self._world)
        self._api.setPhysicsEngineParameter(
            numSolverIterations=former["numSolverIterations"], warmStartingFactor=WARM_STARTING, **self._world
        )
        self._dt, self._inertia_stale = 0.0, False

    def state(self, body: int) -> BodyState:
        frame = self._frames[body]
        position, (x, y, z, w) = self._api.getBasePositionAndOrientation(self._ids[body], **self._world)
        velocity, angular_velocity = self._api.getBaseVelocity(self._ids[body], **self._world)
        quat = quat_multiply(np.array([w, x, y, z]), frame.quat_wxyz * [1, -1, -1, -1])
        origin = np.array(position) - rotation_matrix(quat) @ frame.centre
        return BodyState(origin, quat, np.array(velocity), np.array(angular_velocity))

    def contacts(self, body: int, start: BodyState) -> list[ContactPoint]:
        found: list[ContactPoint] = []
        for point in self._api.getContactPoints(bodyA=self._ids[body], **self._world):
            first, second = self._bodies[point[1]], self._bodies[point[2]]
            impulse = point[9] * self._dt  # Bullet reports a force
            if impulse > 0:
                sign = 1.0 if first == body else -1.0  # Bullet's normal points from the second to the first
                position = point[5] if first == body else point[6]
                other = second if first == body else first
                found.append(ContactPoint(other, np.array(position), sign * np.array(point[7]), impulse))
        return sorted(found, key=lambda c: (c.other, -c.impulse, *c.position))

    def close(self) -> None:
        self._api.disconnect(**self._world)
        self._opened.close()

    def _add(self, shape: int, mass: float, moments: Floats, frame: _Frame, state: BodyState, damping: float) -> int:
        handle = self._api.createMultiBody(mass, shape, useMaximalCoordinates=1, **self._world)
        self._set_contact(handle, self._friction)
        # MassProperties and inertia in one call: Bullet's bodies turn NaN when only the inertia is given.
        self._api.changeDynamics(
            handle,
            -1,
            mass=mass,
            localInertiaDiagonal=list(moments),
            linearDamping=0.0,
            angularDamping=1 - np.exp(-damping),  # Bullet: the share lost in a second
            **self._world,
        )
        body = self._register(handle, frame)
        self.set_state(body, state)
        return body

    def _register(self, handle: int, frame: _Frame) -> int:
        body = next(self._count)
        self._ids[body], self._bodies[handle], self._frames[body] = handle, body, frame
        return body

    def _set_contact(self, handle: int, friction: float) -> None:
        self._api.changeDynamics(handle, -1, lateralFriction=friction, restitution=self._restitution, **self._world)

    def _shape(self, hulls: list[Floats]) -> int:
        if len(hulls) == 1:
            points = hulls[0].tolist()
            return self._api.createCollisionShape(self._api.GEOM_MESH, vertices=points, **self._world)
        # pybullet makes a compound of hulls only from a file with an object for each. It reads the file again when
        # the body is created, so the file stays until the engine is closed.
        path = self._folder / f"{next(self._files)}.obj"
        path.write_text(_obj(hulls), encoding="ascii")
        return self._api.createCollisionShape(self._api.GEOM_MESH, fileName=str(path), **self._world)


def _to_bullet(state: BodyState, frame: _Frame) -> tuple[list[float], list[float]]:
    """Position of the centre of mass and orientation (x, y, z, w) of the principal axes."""
    w, x, y, z = quat_multiply(state.quat_wxyz, frame.quat_wxyz)
    return list(state.position + rotation_matrix(state.quat_wxyz) @ frame.centre), [x, y, z, w]


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
