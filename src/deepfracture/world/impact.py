"""From the contact points of an engine to the `Impact` that a breaker gets.

The engine knows where and along which normals bodies pushed each other; momentum tells how much. The total impulse
from each striker is m dv of the bodies (friction included), distributed over its contact points in proportion to the
normal impulses of the engine. Positions and normals are then projected to the true surface, because the convex
collision shapes deviate from it by up to some centimetres where the shape is hollow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deepfracture.geometry import closest_points
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import Floats, Impact, Mesh
from deepfracture.world.engine import BodyState, ContactPoint

MIN_APPROACH_SPEED = 0.3
"""Slower contacts are resting or settling, not collisions [m/s]: a fall of half a centimetre."""
MERGE_DISTANCE = 0.05
"""Contacts of one striker nearer to each other are one [m]: neighbouring convex parts share an impact."""
BALL_MERGE_DISTANCE = 0.3
"""The same for a ball, in radii, if that is more."""
MIN_IMPULSE_FRACTION = 0.01
"""Impulses below this fraction of the strongest are left out."""
CANCELLATION_TOL = 1e-6
"""Normal impulses whose sum is below this fraction of their total cancel: the sum has no direction."""
PROBE_DISTANCE = 0.1
"""The closest surface point is sought from this far outside the contact [m] (or from half the striker's radius, if that
is less), so that it is on the side that was struck."""


@dataclass(frozen=True, eq=False)
class CollisionContact:
    """A contact point and how fast the bodies approached each other there."""

    point: ContactPoint
    approach_speed: float
    """Along the normal, before the step [m/s]; negative when they separate."""


@dataclass(frozen=True, eq=False)
class CollidingBody:
    """A moving body in a collision."""

    before: BodyState
    after: BodyState
    impulse: Floats
    """Momentum gained from contacts during the step [N s], world frame, shape (3,)."""
    is_ball: bool


@dataclass(frozen=True, eq=False)
class _PointImpulse:
    """The impulse at one place, of all contact points merged there; world frame."""

    position: Floats
    normal: Floats
    impulse: Floats
    approach_speed: float
    radius: float


def impact_of(
    mesh: Mesh,
    struck: CollidingBody,
    contacts: Sequence[CollisionContact],
    strikers: Mapping[int, CollidingBody],
    radii: Mapping[int, float],
) -> Impact | None:
    """The impulses on `struck` in its body frame, strongest first.

    `strikers` are the moving bodies among those in contact, by number, and `radii` the radii of curvature of all in
    contact [m]. None if `struck` gained no momentum: an engine may report a contact that it has not resolved yet."""
    found: list[_PointImpulse] = []
    for other, total in impulses_by_body(struck, contacts, strikers).items():
        merge = max(MERGE_DISTANCE, BALL_MERGE_DISTANCE * radii[other]) if other in strikers else MERGE_DISTANCE
        found += _point_impulses([c for c in contacts if c.point.other == other], total, radii[other], merge)
    found.sort(key=lambda one: -float(np.linalg.norm(one.impulse)))
    strongest = float(np.linalg.norm(found[0].impulse))
    if strongest == 0:
        return None
    found = [one for one in found if np.linalg.norm(one.impulse) > MIN_IMPULSE_FRACTION * strongest]
    turn = rotation_matrix(struck.before.quat_wxyz)
    impulse = np.array([one.impulse for one in found]) @ turn
    contact = (np.array([one.position for one in found]) - struck.before.position) @ turn
    magnitude = np.linalg.norm(impulse, axis=1)
    direction = impulse / magnitude[:, None]
    inward = np.array([one.normal for one in found]) @ turn
    reach = np.minimum(PROBE_DISTANCE, 0.5 * np.array([one.radius for one in found]))
    position, normal = _project_to_surface(mesh, contact - reach[:, None] * inward)
    # A support may react with a larger impulse than the striker's, but the striker sets the duration of the contact.
    leading = next((one for one in found if one.approach_speed >= MIN_APPROACH_SPEED), found[0])
    return Impact(
        position, direction, magnitude, normal, max(leading.approach_speed, MIN_APPROACH_SPEED), leading.radius
    )


def merge_impacts(impacts: Sequence[Impact]) -> Impact:
    """Several impacts on one body as one, strongest impulse first; speed and radius are the strongest's."""
    if len(impacts) == 1:
        return impacts[0]
    strongest = max(impacts, key=lambda impact: float(impact.magnitude[0]))
    order = np.argsort(-np.concatenate([impact.magnitude for impact in impacts]), kind="stable")
    position, direction, magnitude, normal = (
        np.concatenate([getattr(impact, name) for impact in impacts])[order]
        for name in ("position", "direction", "magnitude", "normal")
    )
    return Impact(position, direction, magnitude, normal, strongest.speed, strongest.radius)


def impulses_by_body(
    struck: CollidingBody, contacts: Sequence[CollisionContact], strikers: Mapping[int, CollidingBody]
) -> dict[int, Floats]:
    """The total impulse on `struck` from each body in contact, friction included [N s], world frame."""
    normal: dict[int, Floats] = {}
    for contact in contacts:
        impulse = contact.point.impulse * contact.point.normal
        normal[contact.point.other] = normal.get(contact.point.other, np.zeros(3)) + impulse
    # What a ball loses the struck body gains. If one other body remains, the rest of the momentum came from it.
    balls = {n for n in normal if n in strikers and strikers[n].is_ball}
    found = {n: -strikers[n].impulse if n in balls else impulse for n, impulse in normal.items()}
    others = [n for n in found if n not in balls] or list(found)
    if len(others) == 1:
        found[others[0]] = struck.impulse - sum((p for n, p in found.items() if n != others[0]), np.zeros(3))
    return found


def _point_impulses(
    contacts: list[CollisionContact], total: Floats, radius: float, merge_distance: float
) -> list[_PointImpulse]:
    """The impulse `total` of one body distributed over its contacts, each merged with stronger ones nearby."""
    weights = np.array([contact.point.impulse for contact in contacts])
    normals = np.array([contact.point.normal for contact in contacts])
    points = np.array([contact.point.position for contact in contacts])
    impulses = weights[:, None] * normals
    impulses += np.outer(weights / weights.sum(), total - impulses.sum(axis=0))
    left = list(np.argsort(-weights, kind="stable"))
    found = []
    while left:
        near = [i for i in left if np.linalg.norm(points[i] - points[left[0]]) < merge_distance]
        left = [i for i in left if i not in near]
        position = weights[near] @ points[near] / weights[near].sum()
        normal = weights[near] @ normals[near]
        length = float(np.linalg.norm(normal))
        # Where equal normals oppose each other, the strongest contact counts.
        normal = normal / length if length > CANCELLATION_TOL * weights[near].sum() else normals[near[0]]
        approach_speed = max(contacts[i].approach_speed for i in near)
        found.append(_PointImpulse(position, normal, impulses[near].sum(axis=0), approach_speed, radius))
    return found


def _project_to_surface(mesh: Mesh, outside: Floats) -> tuple[Floats, Floats]:
    """The closest surface points to points outside, and the outward normals there, shape (n, 3) each.

    The direction from the closest point of a surface to a point outside is normal to the surface: in a triangle it is
    the triangle's normal, on an edge or vertex the one of its many normals that faces the striker."""
    found = closest_points(mesh, outside)
    away = outside - found.points
    length = np.linalg.norm(away, axis=1, keepdims=True)
    area = mesh.area_vectors[found.faces]
    flat = area / np.linalg.norm(area, axis=1, keepdims=True)
    return found.points, np.where(length > 1e-6, away / np.maximum(length, 1e-6), flat)
