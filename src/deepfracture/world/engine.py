"""The one seam between the world and a rigid-body engine.

Every pose at the seam is that of the mesh frame; velocities are those of the centre of mass. What an
engine does inside (principal axes, margins) stays inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Floats

ENGINES = ("bullet", "rapier")


@dataclass(frozen=True, eq=False)
class Mass:
    """How a body resists being moved."""

    mass: float
    """[kg]"""
    centre: Floats
    """Centre of mass in the mesh frame [m], shape (3,)."""
    inertia: Floats
    """About the centre of mass, axes of the mesh frame [kg m^2], shape (3, 3)."""

    def principal(self) -> tuple[Floats, Floats]:
        """Principal moments, shape (3,), and the rotation mesh_from_principal, shape (3, 3)."""
        moments, axes = np.linalg.eigh(self.inertia)
        if np.linalg.det(axes) < 0:
            axes[:, 0] *= -1
        return moments, axes


@dataclass(frozen=True, eq=False)
class Motion:
    """Where a body is and how it moves, in the world frame."""

    position: Floats
    """Origin of the mesh frame [m], shape (3,)."""
    quat_wxyz: Floats
    """Rotation world_from_mesh, shape (4,)."""
    velocity: Floats
    """Of the centre of mass [m/s], shape (3,)."""
    spin: Floats
    """Angular velocity [rad/s], shape (3,)."""


@dataclass(frozen=True, eq=False)
class Contact:
    """One contact point of the last step that pushed."""

    other: int
    """The body that pushed."""
    position: Floats
    """On the surface of the pushed body when the step began [m], world frame, shape (3,)."""
    normal: Floats
    """Unit direction of the push on the body, world frame, shape (3,)."""
    impulse: float
    """Normal impulse of the step [N s]; friction is not in it."""


class Engine(Protocol):
    """Bodies are numbers, given out in the order in which they were added."""

    def add_body(self, hulls: Sequence[Floats], mass: Mass, motion: Motion) -> int:
        """A rigid body whose collision shape is the union of convex hulls, points in the mesh frame."""
        ...

    def add_ball(self, radius: float, mass: float, motion: Motion) -> int:
        """A solid ball whose rolling is slowed as on a hard floor."""
        ...

    def add_floor(self, height: float, friction: float) -> int:
        """A fixed floor under z = height."""
        ...

    def add_block(self, half_sides: Floats, friction: float, motion: Motion) -> int:
        """A fixed box about the origin of its frame, which stays where `motion` has it."""
        ...

    def remove(self, body: int) -> None: ...

    def move(self, body: int, motion: Motion) -> None:
        """Put a body somewhere with some velocity."""
        ...

    def slow(self, body: int, factor: float) -> None:
        """Multiply a body's velocities."""
        ...

    def prefer_piles(self) -> None:
        """From now on stable piles matter more than exact rebounds; an engine that is good at both ignores it."""
        ...

    def step(self, dt: float) -> None: ...

    def motion(self, body: int) -> Motion: ...

    def contacts(self, body: int, began: Motion) -> list[Contact]:
        """What pushed the body in the last step, which it began as `began`, in a reproducible order."""
        ...

    def close(self) -> None:
        """Release the engine."""
        ...


@dataclass(frozen=True)
class Surface:
    """How bodies touch."""

    friction: float
    """Coulomb coefficient between two bodies."""
    restitution: float
    """Separation speed over closing speed."""


FLOOR_REACH = 100.0
"""Half the side of the floor [m]."""
FLOOR_DEPTH = 5.0
"""Half the depth of the floor [m]: nothing gets through."""
ROLLING = 1.5
"""Rate at which balls lose their spin [1/s]; without it a ball rolls for ever."""
TURNING = 0.1
"""The same for everything else: fragments that spin on a point come to rest."""


def open_engine(name: str, *, gravity: float, surface: Surface) -> Engine:
    """An empty world with `gravity` [m/s^2] along -z. BadInput if the engine cannot be had."""
    if name == "bullet":
        from deepfracture.world.bullet import Bullet

        return Bullet(gravity, surface)
    if name == "rapier":
        from deepfracture.world.rapier import Rapier

        return Rapier(gravity, surface)
    raise BadInput(f"engine must be one of {', '.join(ENGINES)}, got {name!r}{did_you_mean(name, ENGINES)}")
