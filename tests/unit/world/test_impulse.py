"""From contacts to impulses."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry import builtin
from deepfracture.world.engine import Contact, Motion
from deepfracture.world.impulse import Party, Push, impact_of

STILL = Motion(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
MESH = builtin("bar").mesh
BALL = 7


def party(gained: np.ndarray, *, ball: bool = False) -> Party:
    return Party(STILL, STILL, gained, ball)


def push(impulse: float) -> Push:
    return Push(Contact(BALL, np.array([1.0, 0, 0]), np.array([-1.0, 0, 0]), impulse), 5.0)


def test_a_blow_is_what_the_body_has_gained() -> None:
    gained = np.array([-30.0, 4.0, 0.0])
    impact = impact_of(MESH, party(gained), [push(50.0)], {BALL: party(-gained, ball=True)}, {BALL: 0.2})
    assert impact is not None
    np.testing.assert_allclose(impact.magnitude[:, None] * impact.direction, [gained])


def test_what_has_gained_nothing_was_not_hit() -> None:
    """Whatever impulse the engine tells of."""
    nothing = np.zeros(3)
    assert impact_of(MESH, party(nothing), [push(50.0)], {BALL: party(nothing)}, {BALL: 0.2}) is None


def test_contacts_that_cancel_are_a_blow_from_the_side_of_the_stronger() -> None:
    both = [push(50.0), Push(Contact(BALL, np.array([0.99, 0, 0]), np.array([1.0, 0, 0]), 50.0), 5.0)]
    gained = np.array([-20.0, 0.0, 0.0])
    impact = impact_of(MESH, party(gained), both, {BALL: party(-gained, ball=True)}, {BALL: 0.2})
    assert impact is not None and np.isfinite(impact.normal).all()
    np.testing.assert_allclose(impact.magnitude, [20.0])
