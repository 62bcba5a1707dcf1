"""From contacts to impulses."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry import builtin
from deepfracture.world.engine import BodyState, ContactPoint
from deepfracture.world.impact import CollidingBody, CollisionContact, impact_of

STILL = BodyState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
MESH = builtin("bar").mesh
BALL = 7


def colliding(gained: np.ndarray, *, is_ball: bool = False) -> CollidingBody:
    return CollidingBody(STILL, STILL, gained, is_ball)


def contact(impulse: float) -> CollisionContact:
    return CollisionContact(ContactPoint(BALL, np.array([1.0, 0, 0]), np.array([-1.0, 0, 0]), impulse), 5.0)


def test_a_blow_is_what_the_body_has_gained() -> None:
    gained = np.array([-30.0, 4.0, 0.0])
    impact = impact_of(MESH, colliding(gained), [contact(50.0)], {BALL: colliding(-gained, is_ball=True)}, {BALL: 0.2})
    assert impact is not None
    np.testing.assert_allclose(impact.magnitude[:, None] * impact.direction, [gained])


def test_what_has_gained_nothing_was_not_hit() -> None:
    """Whatever impulse the engine tells of."""
    nothing = np.zeros(3)
    assert impact_of(MESH, colliding(nothing), [contact(50.0)], {BALL: colliding(nothing)}, {BALL: 0.2}) is None


def test_contacts_that_cancel_are_a_blow_from_the_side_of_the_stronger() -> None:
    both = [
        contact(50.0),
        CollisionContact(ContactPoint(BALL, np.array([0.99, 0, 0]), np.array([1.0, 0, 0]), 50.0), 5.0),
    ]
    gained = np.array([-20.0, 0.0, 0.0])
    impact = impact_of(MESH, colliding(gained), both, {BALL: colliding(-gained, is_ball=True)}, {BALL: 0.2})
    assert impact is not None and np.isfinite(impact.normal).all()
    np.testing.assert_allclose(impact.magnitude, [20.0])
