"""Rapier (rapier3d, Apache-2.0) behind the engine seam. Its bodies live in the mesh frame as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepfracture.geometry.rotations import quat_from_matrix, rotation_matrix
from deepfracture.types import Floats
from deepfracture.world.engine import FLOOR_DEPTH, FLOOR_REACH, ROLLING, TURNING, Contact, Mass, Motion, Surface

SEPARATION = 1.0
"""Greatest speed at which overlapping bodies are moved apart [m/s] ..."""
RELAXATION = 6
"""... and how many iterations then take that speed from them again. With Rapier's one, fragments whose hulls
overlap a little burst apart; a slower separation instead lets corners sink into the floor."""
SLOP = 0.001
"""Overlap that is left alone [m]."""
BODY_STIFFNESS, FLOOR_STIFFNESS = 120.0, 240.0
"""Natural frequencies of contacts [Hz]; with Rapier's 30 and 60 corners sink 2 cm into the floor before they
are pushed back, and piles rock on them for ever."""


class Rapier:
    def __init__(self, gravity: float, surface: Surface) -> None:
        import rapier3d

        self._api = rapier3d
        self._world = rapier3d.PhysicsWorld(gravity=(0.0, 0.0, -gravity))
        self._world.set_num_threads(1)  # sums in one order: same seed, same bytes
        solver = self._world.integration_parameters
        solver.normalized_max_corrective_velocity = SEPARATION
        solver.num_internal_stabilization_iterations = RELAXATION
        solver.normalized_allowed_linear_error = SLOP
        solver.contact_softness = rapier3d.SpringCoefficients(BODY_STIFFNESS, 10.0)
        solver.static_contact_softness = rapier3d.SpringCoefficients(FLOOR_STIFFNESS, 10.0)
        self._friction = float(np.sqrt(surface.friction))
        self._restitution = float(np.sqrt(surface.restitution))
        self._handles: dict[int, Any] = {}
        self._number: dict[Any, int] = {}
        self._next = 0

    def add_body(self, hulls: Sequence[Floats], mass: Mass, motion: Motion) -> int:
        api = self._api
        moments, axes = mass.principal()
        properties = api.MassProperties(
            local_com=tuple(mass.centre.tolist()),  # numbers of Python are read much faster
            mass=float(mass.mass),
            principal_inertia=tuple(moments.tolist()),
            principal_inertia_local_frame=api.Rotation3(*quat_from_matrix(axes).tolist()),
        )
        looks = self._looks(self._friction)
        return self._add(properties, motion, TURNING, [api.Collider.convex_hull(h, **looks) for h in hulls])

    def add_ball(self, radius: float, mass: float, motion: Motion) -> int:
        api = self._api
        inertia = 0.4 * mass * radius**2
        properties = api.MassProperties(
            local_com=(0.0, 0.0, 0.0), mass=mass, principal_inertia=(inertia, inertia, inertia)
        )
        ball = api.Collider.ball(radius, **self._looks(self._friction))
        return self._add(properties, motion, ROLLING, [ball])

    def add_floor(self, height: float, friction: float) -> int:
        # A half-space lets hulls sink in deeply; a cuboid does not.
        api = self._api
        looks = self._looks(friction / self._friction)
        box = api.Collider.cuboid(FLOOR_REACH, FLOOR_REACH, FLOOR_DEPTH, **looks)
        fixed = api.RigidBodyBuilder(api.RigidBodyType.FIXED).translation((0.0, 0.0, height - FLOOR_DEPTH))
        return self._keep(self._world.add_body(fixed, [box]))

    def add_block(self, half_sides: Floats, friction: float, motion: Motion) -> int:
        api = self._api
        box = api.Collider.cuboid(*map(float, half_sides), **self._looks(friction / self._friction))
        fixed = api.RigidBodyBuilder(api.RigidBodyType.FIXED).position(self._pose(motion))
        return self._keep(self._world.add_body(fixed, [box]))

    def remove(self, body: int) -> None:
        handle = self._handles.pop(body)
        del self._number[handle]
        self._world.remove_body(handle)

    def move(self, body: int, motion: Motion) -> None:
        held = self._body(body)
        held.position = self._pose(motion)
        held.linvel = tuple(motion.velocity)
        held.angvel = tuple(motion.spin)

    def slow(self, body: int, factor: float) -> None:
        held = self._body(body)
        held.linvel = tuple(factor * v for v in held.linvel.to_tuple())
        held.angvel = tuple(factor * v for v in held.angvel.to_tuple())

    def prefer_piles(self) -> None:
        pass  # its contacts are exact and stable at once

    def step(self, dt: float) -> None:
        self._world.integration_parameters.dt = dt
        self._world.step()

    def motion(self, body: int) -> Motion:
        held = self._body(body)
        turn = held.rotation
        return Motion(
            np.array(held.translation.to_tuple()),
            _unit(np.array([turn.w, turn.i, turn.j, turn.k])),
            np.array(held.linvel.to_tuple()),
            np.array(held.angvel.to_tuple()),
        )

    def contacts(self, body: int, began: Motion) -> list[Contact]:
        found: list[Contact] = []
        turn = rotation_matrix(began.quat_wxyz)
        for collider in self._body(body).colliders:
            for pair in self._world.narrow_phase.contact_pairs_with(collider):
                # Points are in the frame of the first collider, which is its body's: none has an offset.
                first = self._owner(pair.collider1)
                other = self._owner(pair.collider2) if first == body else first
                push = -1.0 if first == body else 1.0
                for manifold in pair.manifolds:
                    normal = push * np.array(manifold.data.normal.to_tuple())
                    for point in manifold.points:
                        if point.impulse > 0:
                            local = (point.local_p1 if first == body else point.local_p2).to_tuple()
                            place = began.position + turn @ np.array(local)
                            found.append(Contact(other, place, normal, point.impulse))
        return sorted(found, key=lambda c: (c.other, -c.impulse, *c.position))

    def close(self) -> None:
        self._world.clear()

    def _add(self, properties: Any, motion: Motion, damping: float, colliders: list[Any]) -> int:
        builder = (
            self._api.RigidBodyBuilder(self._api.RigidBodyType.DYNAMIC)
            .position(self._pose(motion))
            .linvel(tuple(motion.velocity.tolist()))
            .angvel(tuple(motion.spin.tolist()))
            .angular_damping(damping)
            .additional_mass_properties(properties)
            .can_sleep(False)
        )
        return self._keep(self._world.add_body(builder, colliders))

    def _keep(self, handle: Any) -> int:
        body = self._next
        self._next += 1
        self._handles[body] = handle
        self._number[handle] = body
        return body

    def _body(self, body: int) -> Any:
        return self._world.rigid_bodies.get(self._handles[body])

    def _owner(self, handle: Any) -> int:
        collider: Any = self._world.colliders.get(handle)
        return self._number[collider.parent]

    def _looks(self, friction: float) -> dict[str, Any]:
        multiply = self._api.CoefficientCombineRule.MULTIPLY  # as Bullet does
        return {
            "density": 0.0,
            "friction": friction,
            "restitution": self._restitution,
            "friction_combine_rule": multiply,
            "restitution_combine_rule": multiply,
        }

    def _pose(self, motion: Motion) -> Any:
        place = self._api.Vec3(*motion.position.tolist())
        return self._api.Isometry3(place, self._api.Rotation3(*motion.quat_wxyz.tolist()))


def _unit(quat: Floats) -> Floats:
    return quat / np.linalg.norm(quat)  # Rapier computes in float32
