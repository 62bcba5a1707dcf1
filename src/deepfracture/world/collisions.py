"""Collisions of breakable bodies, found in the contacts of an engine's last step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deepfracture.geometry.rotations import cross, rotation_matrix
from deepfracture.types import Floats, Impact
from deepfracture.world.engine import BodyState, ContactPoint, Engine
from deepfracture.world.impact import (
    MIN_APPROACH_SPEED,
    CollidingBody,
    CollisionContact,
    impact_of,
    impulses_by_body,
)
from deepfracture.world.rigid_body import RigidBody


@dataclass(frozen=True, eq=False)
class Striker:
    """A moving body that struck another, and what the collision did to it."""

    body: RigidBody
    before: BodyState
    impulse: Floats
    """On the striker [N s], world frame, shape (3,)."""
    angular_impulse: Floats
    """On the striker about its centre of mass [N m s], world frame, shape (3,)."""
    only_contact: bool
    """Whether it touched nothing else in that step."""


@dataclass(frozen=True, eq=False)
class CollisionEvent:
    """A breakable body was struck in the last step."""

    body: RigidBody
    impact: Impact
    before: BodyState
    after: BodyState
    strikers: tuple[Striker, ...]


@dataclass(frozen=True, eq=False)
class Step:
    """The last step of an engine."""

    engine: Engine
    bodies: Mapping[int, RigidBody]
    before: Mapping[int, BodyState]
    """States of the moving bodies when it began, by number."""
    gravity: float
    """[m/s^2]"""
    dt: float
    """[s]"""

    def contacts(self, body: int) -> list[ContactPoint]:
        return self.engine.contacts(body, self.before[body])

    def approach_speed(self, body: RigidBody, contact: ContactPoint) -> float:
        """Of the body and what it touches, along the normal [m/s]."""
        velocity = body.velocity_at(contact.position, self.before[body.number])
        other = self.bodies[contact.other]
        if not other.fixed:
            velocity = velocity - other.velocity_at(contact.position, self.before[contact.other])
        return float(-velocity @ contact.normal)

    def colliding(self, body: RigidBody) -> CollidingBody:
        """The body with the momentum that its contacts gave it."""
        before, after = self.before[body.number], self.engine.state(body.number)
        weight = np.array([0.0, 0.0, -body.mass.mass * self.gravity * self.dt])
        impulse = body.mass.mass * (after.velocity - before.velocity) - weight
        return CollidingBody(before, after, impulse, body.kind == "ball")


def collision_event(step: Step, body: RigidBody) -> CollisionEvent | None:
    """What struck the body in the step; None if nothing did, or not fast enough."""
    contacts = [CollisionContact(point, step.approach_speed(body, point)) for point in step.contacts(body.number)]
    if not contacts or max(contact.approach_speed for contact in contacts) < MIN_APPROACH_SPEED:
        return None
    others = [step.bodies[number] for number in sorted({contact.point.other for contact in contacts})]
    struck = step.colliding(body)
    strikers = {other.number: step.colliding(other) for other in others if not other.fixed}
    radii = {other.number: other.radius for other in others}
    assert body.mesh is not None
    impact = impact_of(body.mesh, struck, contacts, strikers, radii)
    if impact is None:
        return None
    return CollisionEvent(body, impact, struck.before, struck.after, _strikers(step, body, struck, contacts, strikers))


def _strikers(
    step: Step,
    body: RigidBody,
    struck: CollidingBody,
    contacts: Sequence[CollisionContact],
    strikers: Mapping[int, CollidingBody],
) -> tuple[Striker, ...]:
    """The moving bodies that struck, each with the reaction to its part of what the struck body gained.

    The contacts of an engine do not report friction, so the momentum and angular momentum that they do not account for
    is distributed in proportion to the impulses. With one striker this is exact."""
    impulses = impulses_by_body(struck, contacts, strikers)
    sizes = {n: float(np.linalg.norm(impulse)) for n, impulse in impulses.items()}
    missing = struck.impulse - sum(impulses.values(), np.zeros(3))
    impulses = {n: impulse + missing * (sizes[n] / sum(sizes.values())) for n, impulse in impulses.items()}
    centre, turn = body.centre_of_mass(struck.before), rotation_matrix(struck.before.quat_wxyz)
    places = {n: _mean_position([c.point for c in contacts if c.point.other == n]) for n in impulses}
    angular = turn @ body.mass.inertia @ turn.T @ (struck.after.angular_velocity - struck.before.angular_velocity)
    angular = angular - sum((cross(places[n] - centre, impulse) for n, impulse in impulses.items()), np.zeros(3))
    found = []
    for n, striker in strikers.items():
        arm = places[n] - step.bodies[n].centre_of_mass(striker.before)
        angular_impulse = cross(arm, impulses[n]) + angular * (sizes[n] / sum(sizes.values()))
        only = all(contact.other == body.number for contact in step.contacts(n))
        found.append(Striker(step.bodies[n], striker.before, -impulses[n], -angular_impulse, only))
    return tuple(found)


def _mean_position(points: list[ContactPoint]) -> Floats:
    """Mean position of the contacts with one body [m], weighted by their impulses."""
    weights = np.array([point.impulse for point in points])
    return weights @ np.array([point.position for point in points]) / weights.sum()
