"""Where a ball starts so that it flies along a ray and soon meets what the ray points at."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.geometry.kernels import offset
from deepfracture.types import Floats, Mesh
from deepfracture.world import GRAVITY, STEEL, Ball

LEAD_TIME = 0.035
"""A ball starts so long before it meets something [s]: enough to see it come ..."""
LEAD = 0.8
"""... and no farther from it than this [m]."""
PAST = 2.0
"""A ball that will miss everything starts this far before the point where it comes nearest to the middle [m]."""
TOUCH = 1e-3
"""Two surfaces so near to each other touch [m]."""
MOST_STEPS = 300
"""Of the march along a ray: one that grazes a surface comes near it ever more slowly."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A body that may stand in a ball's way."""

    mesh: Mesh
    position: Floats
    """Of its frame in the world [m], shape (3,)."""
    turn: Floats
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

    None if the ray begins so near to something that the ball has no room there. `floor`: its height [m]."""
    origin, direction = np.asarray(origin, float), np.asarray(direction, float)
    near = [body for body in obstacles if _near_ray(body, origin, direction, radius)]
    reach = _to_floor(origin, direction, radius, floor)
    way = _march(near, origin, direction, radius, reach)
    if way is None:
        return None
    lead = min(LEAD, LEAD_TIME * speed)
    if np.isinf(way):  # nothing is hit: fly by where it can be seen
        way, lead = max(float(-origin @ direction), 0.0), PAST
    start = origin + max(way - lead, 0.0) * direction
    # Thrown a little upwards, so that it is on the ray again when it arrives.
    rise = gravity * min(lead, way) / speed / 2
    velocity = speed * direction + np.array([0.0, 0.0, rise])
    return Ball(radius, STEEL, _vector(start), _vector(velocity))


def _vector(values: Floats) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _near_ray(body: Obstacle, origin: Floats, direction: Floats, radius: float) -> bool:
    """Whether a ball on the ray may touch the sphere around a body."""
    low, high = body.mesh.bounds
    centre = body.position + body.turn @ ((low + high) / 2) - origin
    reach = float(np.linalg.norm(high - low)) / 2 + radius
    along = max(float(centre @ direction), 0.0)
    return bool(np.linalg.norm(centre - along * direction) <= reach)


def _to_floor(origin: Floats, direction: Floats, radius: float, floor: float) -> float:
    """How far a ball gets before it meets the floor; infinite if it never does."""
    if direction[2] >= 0:
        return np.inf
    return max(float(floor + radius - origin[2]) / float(direction[2]), 0.0)


def _march(bodies: list[Obstacle], origin: Floats, direction: Floats, radius: float, reach: float) -> float | None:
    """How far a ball gets before it touches anything (conservative advancement); None if it touches at once."""
    local = [((origin - body.position) @ body.turn, direction @ body.turn, body.mesh.triangles) for body in bodies]
    way = 0.0
    for _ in range(MOST_STEPS):
        free = min((_distance(t, o + way * d) for o, d, t in local), default=np.inf) - radius
        if free < TOUCH:
            return way if way > 0 else None
        way += free
        if way >= reach:
            return reach
        if np.isinf(way) or way > 1e3:
            return np.inf
    return way


@njit(cache=True, nogil=True)
def _distance(triangles: Floats, point: Floats) -> float:  # pragma: no cover
    """From a point to the nearest of some triangles [m]."""
    best = np.inf
    for t in range(len(triangles)):
        x, y, z = offset(point[0], point[1], point[2], triangles[t])
        best = min(best, x * x + y * y + z * z)
    return np.sqrt(best)
