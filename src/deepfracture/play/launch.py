"""Launches a ball along a ray, from just before what it will hit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.geometry.aabb_tree import offset_from_triangle
from deepfracture.types import Floats, Mesh
from deepfracture.world import GRAVITY, STEEL, Ball, as_vector

LEAD_TIME = 0.035
"""A ball starts this long before it hits something [s]: enough to see it come ..."""
LEAD = 0.8
"""... and no farther from it than this [m]."""
MISS_LEAD = 2.0
"""A ball that will miss everything starts this far before the point of its path nearest to the origin [m]."""
CONTACT_TOL = 1e-3
"""Surfaces nearer to each other are in contact [m]."""
MAX_STEPS = 300
"""Of the march along a ray, whose steps get ever shorter where it grazes a surface."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A body that may be in the way of a ball."""

    mesh: Mesh
    position: Floats
    """Origin of the mesh frame in the world [m], shape (3,)."""
    rotation: Floats
    """Rotation world_from_mesh, shape (3, 3)."""


def launch(
    origin: Floats,
    direction: Floats,
    *,
    radius: float,
    speed: float,
    obstacles: Iterable[Obstacle],
    floor: float,
    gravity: float = GRAVITY,
) -> Ball | None:
    """A steel ball on the ray from `origin` [m] along the unit vector `direction`, just before what it will hit.

    `speed` in m/s, `floor`: its height [m]. None if the ball has no room at the origin of the ray."""
    origin, direction = np.asarray(origin, float), np.asarray(direction, float)
    near = [body for body in obstacles if _near_ray(body, origin, direction, radius)]
    reach = _to_floor(origin, direction, radius, floor)
    distance = _march(near, origin, direction, radius, reach)
    if distance is None:
        return None
    lead = min(LEAD, LEAD_TIME * speed)
    if np.isinf(distance):  # nothing is hit: fly by in view
        distance, lead = max(float(-origin @ direction), 0.0), MISS_LEAD
    start = origin + max(distance - lead, 0.0) * direction
    # Thrown slightly upwards, so that gravity brings it back to the ray at the hit.
    rise = gravity * min(lead, distance) / speed / 2
    velocity = speed * direction + np.array([0.0, 0.0, rise])
    return Ball(radius, STEEL, as_vector(start), as_vector(velocity))


def _near_ray(body: Obstacle, origin: Floats, direction: Floats, radius: float) -> bool:
    """Whether a ball on the ray may touch the bounding sphere of a body."""
    low, high = body.mesh.bounds
    centre = body.position + body.rotation @ ((low + high) / 2) - origin
    reach = float(np.linalg.norm(high - low)) / 2 + radius
    along = max(float(centre @ direction), 0.0)
    return bool(np.linalg.norm(centre - along * direction) <= reach)


def _to_floor(origin: Floats, direction: Floats, radius: float, floor: float) -> float:
    """Distance to the floor along the ray [m]; infinite if the ball never meets it."""
    if direction[2] >= 0:
        return np.inf
    return max(float(floor + radius - origin[2]) / float(direction[2]), 0.0)


def _march(bodies: list[Obstacle], origin: Floats, direction: Floats, radius: float, reach: float) -> float | None:
    """Distance along the ray until the ball touches anything (sphere tracing: Hart 1996); None if it does at once."""
    local = [
        ((origin - body.position) @ body.rotation, direction @ body.rotation, body.mesh.triangles) for body in bodies
    ]
    travelled = 0.0
    for _ in range(MAX_STEPS):
        free = min((_distance(t, o + travelled * d) for o, d, t in local), default=np.inf) - radius
        if free < CONTACT_TOL:
            return travelled if travelled > 0 else None
        travelled += free
        if travelled >= reach:
            return reach
        if np.isinf(travelled) or travelled > 1e3:
            return np.inf
    return travelled


@njit(cache=True, nogil=True)
def _distance(triangles: Floats, point: Floats) -> float:  # pragma: no cover
    """From a point to the nearest of some triangles [m]."""
    best = np.inf
    for t in range(len(triangles)):
        x, y, z = offset_from_triangle(point[0], point[1], point[2], triangles[t])
        best = min(best, x * x + y * y + z * z)
    return np.sqrt(best)
