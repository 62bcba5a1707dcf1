"""Body replacement: the states in which fragments take the place of the body that broke.

The fragments start where the body was before the step in which it broke, with its v + omega x r, so they have its
momentum. With `Scene.impulse_fraction` = 1, (v, omega) is what it had after the collision; with less, the rest of the
impulse goes back to the strikers, which then push the fragments that they meet. The body and its strikers stand where
they were before the contact: only there do the impulses balance the moments, too.
"""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.rotations import cross, rotation_matrix
from deepfracture.types import Fragment
from deepfracture.world.collisions import CollisionEvent, Striker
from deepfracture.world.engine import BodyState


def broken_state(event: CollisionEvent, fraction: float) -> BodyState:
    """The state before the collision, with a fraction of what the collision did to the velocities."""
    before, after = event.before, event.after
    return BodyState(
        before.position,
        before.quat_wxyz,
        before.velocity + fraction * (after.velocity - before.velocity),
        before.angular_velocity + fraction * (after.angular_velocity - before.angular_velocity),
    )


def fragment_state(event: CollisionEvent, broken: BodyState, fragment: Fragment) -> BodyState:
    """Pose and angular velocity of the body that broke, and its velocity at the fragment's centre of mass."""
    arm = rotation_matrix(broken.quat_wxyz) @ (fragment.centre - event.body.mass.centre)
    velocity = broken.velocity + cross(broken.angular_velocity, arm)
    return BodyState(broken.position, broken.quat_wxyz, velocity, broken.angular_velocity)


def striker_state(striker: Striker, after: BodyState, fraction: float) -> BodyState:
    """The state of a striker before the contact, with a fraction of what the collision did to it.

    `after` the collision it may have been struck by others, too, which stays. Otherwise the engine's velocities do not
    count, because an engine may lose angular momentum in a contact."""
    mass, before = striker.body.mass, striker.before
    turn = rotation_matrix(before.quat_wxyz)
    kick = striker.impulse / mass.mass
    angular_kick = turn @ np.linalg.solve(mass.inertia, turn.T @ striker.angular_impulse)
    velocity = before.velocity + fraction * kick
    angular_velocity = before.angular_velocity + fraction * angular_kick
    if not striker.only_contact:
        velocity = after.velocity + (fraction - 1) * kick
        angular_velocity = after.angular_velocity + (fraction - 1) * angular_kick
    return BodyState(before.position, before.quat_wxyz, velocity, angular_velocity)
