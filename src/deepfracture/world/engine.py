"""The one seam between the world and a rigid-body engine.

Poses at the seam are those of the mesh frame; velocities are those of the centre of mass. What an engine needs
inside (principal axes, collision margins) stays inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from deepfracture.geometry import MassProperties
from deepfracture.types import Floats

FLOOR_HALF_SIDES = (100.0, 100.0, 5.0)
"""Half the sides of the box that is the floor [m]: so deep that nothing gets through."""
BALL_ANGULAR_DAMPING = 1.5
"""Rate at which a ball loses its angular velocity [1/s]; without rolling resistance it would roll for ever."""
ANGULAR_DAMPING = 0.1
"""The same for every other body: fragments that spin on a point come to rest."""


@dataclass(frozen=True, eq=False)
class BodyState:
    """Pose and velocities of a rigid body, in the world frame."""

    position: Floats
    """Origin of the mesh frame [m], shape (3,)."""
    quat_wxyz: Floats
    """Rotation world_from_mesh, shape (4,)."""
    velocity: Floats
    """Of the centre of mass [m/s], shape (3,)."""
    angular_velocity: Floats
    """[rad/s], shape (3,)."""


@dataclass(frozen=True, eq=False)
class ContactPoint:
    """A contact point of the last step with a normal impulse."""

    other: int
    """The other body."""
    position: Floats
    """On the surface of the body when the step began [m], world frame, shape (3,)."""
    normal: Floats
    """Unit normal, towards the body, world frame, shape (3,)."""
    impulse: float
    """Normal impulse of the step [N s], without friction."""


class Engine(Protocol):
    """A world of rigid bodies, which are known by numbers in the order in which they were added."""

    def add_body(self, hulls: Sequence[Floats], mass: MassProperties, state: BodyState) -> int:
        """A rigid body whose collision shape is the union of convex hulls, points in the mesh frame."""
        ...

    def add_ball(self, radius: float, mass: float, state: BodyState) -> int:
        """A solid ball with rolling resistance."""
        ...

    def add_floor(self, height: float, friction: float) -> int:
        """A fixed floor with its top at z = height."""
        ...

    def add_block(self, half_sides: Floats, friction: float, state: BodyState) -> int:
        """A fixed box about the origin of its frame."""
        ...

    def remove(self, body: int) -> None: ...

    def set_state(self, body: int, state: BodyState) -> None: ...

    def scale_velocity(self, body: int, factor: float) -> None:
        """Multiply the velocity and the angular velocity of a body."""
        ...

    def prefer_stacking(self) -> None:
        """Trade exact rebounds for stable stacks from here on; an engine that is good at both ignores it."""
        ...

    def step(self, dt: float) -> None: ...

    def state(self, body: int) -> BodyState: ...

    def contacts(self, body: int, start: BodyState) -> list[ContactPoint]:
        """Contacts of the body in the last step, in a reproducible order; `start`: its state when the step began."""
        ...

    def close(self) -> None:
        """Release the engine."""
        ...
