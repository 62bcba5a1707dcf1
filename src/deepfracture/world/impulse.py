"""From an engine's contacts to the Impact that a breaker sees.

The engine says where and along which normals bodies pushed each other; momentum says how much. The total
impulse from each striker is m dv of the bodies (friction included), shared among its contacts as the
engine's normal impulses are. Positions and normals are then taken from the true surface, because the
convex parts that collide lie up to some centimetres off it where the shape is hollow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deepfracture.geometry import closest
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import Floats, Impact, Mesh
from deepfracture.world.engine import Contact, Motion

LEAST_CLOSING = 0.3
"""Slower contacts are resting or settling, not collisions [m/s]: a fall of half a centimetre."""
FLOOR_RADIUS = 0.3
"""Radius of curvature that stands for a flat floor or block [m]. In a contact only the relative curvature counts, and
a breaker takes the body to be flat: what meets a floor is not, it is a rim, an edge or a belly of a body
two metres long."""
SPOT = 0.05
"""Contacts of one striker nearer to each other are one [m]: neighbouring convex parts share a blow."""
BALL_SPOT = 0.3
"""The same for a ball, in radii, if that is more."""
NOISE = 0.01
"""Impulses below this share of the strongest are left out."""
SQUEEZED = 1e-6
"""Share of its contacts' impulses that the sum of a blow has at least, or else they cancel and have no direction."""
OUTWARDS = 0.1
"""The surface is sought from this far outside the contact [m] (or from half the striker's radius, if that is
less), so that it is the side which was struck."""


@dataclass(frozen=True, eq=False)
class Push:
    """A contact and how fast the bodies approached there."""

    contact: Contact
    closing: float
    """Along the normal, before the step [m/s]; negative when they part."""


@dataclass(frozen=True, eq=False)
class Party:
    """A moving body that takes part in a collision."""

    before: Motion
    after: Motion
    gained: Floats
    """Momentum from contacts during the step [N s], world frame, shape (3,)."""
    ball: bool


@dataclass(frozen=True, eq=False)
class _Blow:
    position: Floats
    normal: Floats
    impulse: Floats
    closing: float
    radius: float


def impact_of(
    mesh: Mesh, own: Party, pushes: Sequence[Push], parties: Mapping[int, Party], radii: Mapping[int, float]
) -> Impact | None:
    """The impulses on `own` in its body frame, strongest first; `radii` of curvature by striker [m].

    None: it has gained no momentum. An engine may tell of a contact that it has not acted on yet."""
    blows: list[_Blow] = []
    for striker, total in totals(own, pushes, parties).items():
        spot = max(SPOT, BALL_SPOT * radii[striker]) if striker in parties else SPOT
        blows += _blows([p for p in pushes if p.contact.other == striker], total, radii[striker], spot)
    blows.sort(key=lambda blow: -float(np.linalg.norm(blow.impulse)))
    strongest = float(np.linalg.norm(blows[0].impulse))
    if strongest == 0:
        return None
    blows = [blow for blow in blows if np.linalg.norm(blow.impulse) > NOISE * strongest]
    turn = rotation_matrix(own.before.quat_wxyz)
    impulse = np.array([blow.impulse for blow in blows]) @ turn
    contact = (np.array([blow.position for blow in blows]) - own.before.position) @ turn
    magnitude = np.linalg.norm(impulse, axis=1)
    direction = impulse / magnitude[:, None]
    towards = np.array([blow.normal for blow in blows]) @ turn
    reach = np.minimum(OUTWARDS, 0.5 * np.array([blow.radius for blow in blows]))
    position, normal = _on_surface(mesh, contact - reach[:, None] * towards)
    # A support may answer with more than it was asked with, but how long the blow lasts the striker decides.
    leader = next((blow for blow in blows if blow.closing >= LEAST_CLOSING), blows[0])
    return Impact(position, direction, magnitude, normal, max(leader.closing, LEAST_CLOSING), leader.radius)


def merged(impacts: Sequence[Impact]) -> Impact:
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


def totals(own: Party, pushes: Sequence[Push], parties: Mapping[int, Party]) -> dict[int, Floats]:
    """The whole impulse on `own` from each striker, friction included."""
    normal: dict[int, Floats] = {}
    for push in pushes:
        share = push.contact.impulse * push.contact.normal
        normal[push.contact.other] = normal.get(push.contact.other, np.zeros(3)) + share
    # A ball's loss is its striker's gift. What then is missing came from the one striker left over.
    found = {n: -parties[n].gained if n in parties and parties[n].ball else p for n, p in normal.items()}
    rest = [n for n in found if not (n in parties and parties[n].ball)] or list(found)
    if len(rest) == 1:
        found[rest[0]] = own.gained - sum((p for n, p in found.items() if n != rest[0]), np.zeros(3))
    return found


def _blows(pushes: list[Push], total: Floats, radius: float, spot: float) -> list[_Blow]:
    """One striker's contacts, those within `spot` of a stronger one merged into it."""
    weights = np.array([push.contact.impulse for push in pushes])
    normals = np.array([push.contact.normal for push in pushes])
    places = np.array([push.contact.position for push in pushes])
    impulses = weights[:, None] * normals
    impulses += np.outer(weights / weights.sum(), total - impulses.sum(axis=0))
    left = list(np.argsort(-weights, kind="stable"))
    blows = []
    while left:
        near = [i for i in left if np.linalg.norm(places[i] - places[left[0]]) < spot]
        left = [i for i in left if i not in near]
        place = weights[near] @ places[near] / weights[near].sum()
        normal = weights[near] @ normals[near]
        length = float(np.linalg.norm(normal))
        # What is squeezed from both sides alike was hit where it was hit hardest.
        normal = normal / length if length > SQUEEZED * weights[near].sum() else normals[near[0]]
        closing = max(pushes[i].closing for i in near)
        impulse = impulses[near].sum(axis=0)
        blows.append(_Blow(place, normal, impulse, closing, radius))
    return blows


def _on_surface(mesh: Mesh, outside: Floats) -> tuple[Floats, Floats]:
    """The points of the true surface nearest to `outside`, and its outward normals there.

    From a point outside, the way back from the nearest point of a surface is normal to it: in a triangle
    that is the triangle's normal, on an edge or corner the one of its many normals that met the blow."""
    found = closest(mesh, outside)
    away = outside - found.points
    length = np.linalg.norm(away, axis=1, keepdims=True)
    area = mesh.area_vectors[found.faces]
    flat = area / np.linalg.norm(area, axis=1, keepdims=True)
    return found.points, np.where(length > 1e-6, away / np.maximum(length, 1e-6), flat)
