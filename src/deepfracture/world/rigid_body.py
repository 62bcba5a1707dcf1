"""The rigid bodies of a world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.geometry import MassProperties
from deepfracture.geometry.rotations import cross, rotation_matrix
from deepfracture.types import Floats, Ints, Mesh, Shape
from deepfracture.world.engine import BodyState
from deepfracture.world.scene import Ball, Block

FLAT_RADIUS = 0.3
"""Radius of curvature that stands for a flat floor or block [m]. In a contact only the relative curvature counts, and
a breaker takes the body to be flat: what meets a floor is a rim, an edge or a belly of a body two metres long."""


@dataclass(frozen=True, eq=False)
class RigidBody:
    """What does not change about a body."""

    number: int
    """In the engine."""
    name: str
    kind: str
    """As in `types.Track`."""
    mass: MassProperties
    mesh: Mesh | None = None
    """None for balls, blocks and the floor, whose meshes the recorder makes."""
    radius: float = 1.0
    """Radius of curvature at its contacts [m]."""
    hulls: tuple[Floats, ...] = ()
    """Convex collision shapes, points in the mesh frame; none for balls and fixed bodies."""
    shape: Shape | None = None
    """Of a body that may break."""
    whole: Shape | None = None
    """The shape that it is or is a fragment of."""
    generation: int = 0
    """0 for a whole shape, one more than its parent's for a fragment."""
    source: Ints | None = None
    """Of a fragment: `Fragment.source`, in the whole."""
    created: float = 0.0
    """When it entered the world [s]."""

    @property
    def fixed(self) -> bool:
        return self.kind in ("floor", "block")

    def centre_of_mass(self, state: BodyState) -> Floats:
        """In the world [m], shape (3,)."""
        return state.position + rotation_matrix(state.quat_wxyz) @ self.mass.centre

    def velocity_at(self, point: Floats, state: BodyState) -> Floats:
        """Velocity of its material at a point of the world [m/s], shape (3,)."""
        return state.velocity + cross(state.angular_velocity, point - self.centre_of_mass(state))


def fixed_body(number: int, name: str, kind: str) -> RigidBody:
    return RigidBody(number, name, kind, MassProperties(np.inf, np.zeros(3), np.eye(3)), radius=FLAT_RADIUS)


def ball_body(number: int, name: str, ball: Ball, time: float) -> RigidBody:
    mass = MassProperties(ball.mass, np.zeros(3), 0.4 * ball.mass * ball.radius**2 * np.eye(3))
    return RigidBody(number, name, "ball", mass, radius=ball.radius, created=time)


def ball_state(ball: Ball) -> BodyState:
    """State in which a ball enters."""
    return BodyState(np.asarray(ball.position), np.array([1.0, 0, 0, 0]), np.asarray(ball.velocity), np.zeros(3))


def block_state(block: Block) -> BodyState:
    """Pose of a block, at rest."""
    quat = np.asarray(block.quat_wxyz) / np.linalg.norm(block.quat_wxyz)
    return BodyState(np.asarray(block.position), quat, np.zeros(3), np.zeros(3))
