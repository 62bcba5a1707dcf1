"""Rapier (rapier3d, Apache-2.0). Its bodies keep the mesh frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepfracture.geometry import MassProperties
from deepfracture.geometry.rotations import quat_from_matrix, rotation_matrix
from deepfracture.types import ContactMaterial, Floats
from deepfracture.world.engine import ANGULAR_DAMPING, BALL_ANGULAR_DAMPING, FLOOR_HALF_SIDES, BodyState, ContactPoint

DEPENETRATION_SPEED = 1.0
"""Greatest speed at which overlapping bodies are moved apart [m/s] ..."""
STABILIZATION_ITERATIONS = 6
"""... and the iterations that then take this speed from them again. With Rapier's default of one, fragments whose
hulls overlap a little burst apart; with a slower separation corners sink into the floor."""
PENETRATION_SLOP = 0.001
"""Overlap that is not corrected [m]."""
BODY_STIFFNESS, FLOOR_STIFFNESS = 120.0, 240.0
"""Natural frequencies of contacts [Hz]; with Rapier's 30 and 60 corners sink 2 cm into the floor before they
are pushed back, and stacks rock on them for ever."""


class Rapier:
    def __init__(self, gravity: float, contact: ContactMaterial) -> None:
        import rapier3d

        self._api = rapier3d
        self._world = rapier3d.PhysicsWorld(gravity=(0.0, 0.0, -gravity))
        self._world.set_num_threads(1)  # sums in a fixed order: same seed, same bytes
        solver = self._world.integration_parameters
        solver.normalized_max_corrective_velocity = DEPENETRATION_SPEED
        solver.num_internal_stabilization_iterations = STABILIZATION_ITERATIONS
        solver.normalized_allowed_linear_error = PENETRATION_SLOP
        solver.contact_softness = rapier3d.SpringCoefficients(BODY_STIFFNESS, 10.0)
        solver.static_contact_softness = rapier3d.SpringCoefficients(FLOOR_STIFFNESS, 10.0)
        self._friction = float(np.sqrt(contact.friction))
        self._restitution = float(np.sqrt(contact.restitution))
        self._handles: dict[int, Any] = {}
        self._numbers: dict[Any, int] = {}
        self._next = 0

    def add_body(self, hulls: Sequence[Floats], mass: MassProperties, state: BodyState) -> int:
        api = self._api
        moments, axes = mass.principal()
        properties = api.MassProperties(
            local_com=tuple(mass.centre.tolist()),  # Python floats cross the binding much faster than numpy's
            mass=float(mass.mass),
            principal_inertia=tuple(moments.tolist()),
            principal_inertia_local_frame=api.Rotation3(*quat_from_matrix(axes).tolist()),
        )
        options = self._collider_options(self._friction)
        return self._add(properties, state, ANGULAR_DAMPING, [api.Collider.convex_hull(h, **options) for h in hulls])

    def add_ball(self, radius: float, mass: float, state: BodyState) -> int:
        api = self._api
        inertia = 0.4 * mass * radius**2
        properties = api.MassProperties(
            local_com=(0.0, 0.0, 0.0), mass=mass, principal_inertia=(inertia, inertia, inertia)
        )
        ball = api.Collider.ball(radius, **self._collider_options(self._friction))
        return self._add(properties, state, BALL_ANGULAR_DAMPING, [ball])

    def add_floor(self, height: float, friction: float) -> int:
        # A half-space lets hulls sink in deeply; a cuboid does not.
        api = self._api
        options = self._collider_options(friction / self._friction)
        box = api.Collider.cuboid(*FLOOR_HALF_SIDES, **options)
        fixed = api.RigidBodyBuilder(api.RigidBodyType.FIXED).translation((0.0, 0.0, height - FLOOR_HALF_SIDES[2]))
        return self._register(self._world.add_body(fixed, [box]))

    def add_block(self, half_sides: Floats, friction: float, state: BodyState) -> int:
        api = self._api
        box = api.Collider.cuboid(*map(float, half_sides), **self._collider_options(friction / self._friction))
        fixed = api.RigidBodyBuilder(api.RigidBodyType.FIXED).position(self._pose(state))
        return self._register(self._world.add_body(fixed, [box]))

    def remove(self, body: int) -> None:
        handle = self._handles.pop(body)
        del self._numbers[handle]
        self._world.remove_body(handle)

    def set_state(self, body: int, state: BodyState) -> None:
        rigid = self._body(body)
        rigid.position = self._pose(state)
        rigid.linvel = tuple(state.velocity)
        rigid.angvel = tuple(state.angular_velocity)

    def scale_velocity(self, body: int, factor: float) -> None:
        rigid = self._body(body)
        rigid.linvel = tuple(factor * v for v in rigid.linvel.to_tuple())
        rigid.angvel = tuple(factor * v for v in rigid.angvel.to_tuple())

    def prefer_stacking(self) -> None:
        pass  # its contacts are both exact and stable

    def step(self, dt: float) -> None:
        self._world.integration_parameters.dt = dt
        self._world.step()

    def state(self, body: int) -> BodyState:
        rigid = self._body(body)
        turn = rigid.rotation
        return BodyState(
            np.array(rigid.translation.to_tuple()),
            _unit(np.array([turn.w, turn.i, turn.j, turn.k])),
            np.array(rigid.linvel.to_tuple()),
            np.array(rigid.angvel.to_tuple()),
        )

    def contacts(self, body: int, start: BodyState) -> list[ContactPoint]:
        found: list[ContactPoint] = []
        turn = rotation_matrix(start.quat_wxyz)
        for collider in self._body(body).colliders:
            for pair in self._world.narrow_phase.contact_pairs_with(collider):
                # Points are in the frame of the first collider, which is its body's: none has an offset.
                first = self._owner(pair.collider1)
                other = self._owner(pair.collider2) if first == body else first
                sign = -1.0 if first == body else 1.0
                for manifold in pair.manifolds:
                    normal = sign * np.array(manifold.data.normal.to_tuple())
                    for point in manifold.points:
                        if point.impulse > 0:
                            local = (point.local_p1 if first == body else point.local_p2).to_tuple()
                            position = start.position + turn @ np.array(local)
                            found.append(ContactPoint(other, position, normal, point.impulse))
        return sorted(found, key=lambda c: (c.other, -c.impulse, *c.position))

    def close(self) -> None:
        self._world.clear()

    def _add(self, properties: Any, state: BodyState, damping: float, colliders: list[Any]) -> int:
        builder = (
            self._api.RigidBodyBuilder(self._api.RigidBodyType.DYNAMIC)
            .position(self._pose(state))
            .linvel(tuple(state.velocity.tolist()))
            .angvel(tuple(state.angular_velocity.tolist()))
            .angular_damping(damping)
            .additional_mass_properties(properties)
            .can_sleep(False)
        )
        return self._register(self._world.add_body(builder, colliders))

    def _register(self, handle: Any) -> int:
        body = self._next
        self._next += 1
        self._handles[body] = handle
        self._numbers[handle] = body
        return body

    def _body(self, body: int) -> Any:
        return self._world.rigid_bodies.get(self._handles[body])

    def _owner(self, handle: Any) -> int:
        collider: Any = self._world.colliders.get(handle)
        return self._numbers[collider.parent]

    def _collider_options(self, friction: float) -> dict[str, Any]:
        multiply = self._api.CoefficientCombineRule.MULTIPLY  # as Bullet does
        return {
            "density": 0.0,
            "friction": friction,
            "restitution": self._restitution,
            "friction_combine_rule": multiply,
            "restitution_combine_rule": multiply,
        }

    def _pose(self, state: BodyState) -> Any:
        position = self._api.Vec3(*state.position.tolist())
        return self._api.Isometry3(position, self._api.Rotation3(*state.quat_wxyz.tolist()))


def _unit(quat: Floats) -> Floats:
    return quat / np.linalg.norm(quat)  # Rapier computes in float32
