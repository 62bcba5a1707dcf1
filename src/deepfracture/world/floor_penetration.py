"""How deep bodies penetrate the floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepfracture.types import Floats
from deepfracture.world.engine import BodyState
from deepfracture.world.rigid_body import RigidBody

PENETRATION_SLOP = 0.002
"""No body is deeper in the floor than this at the end of a frame [m]; resting bodies sink in less ..."""
MIN_CENTRE_HEIGHT = 1e-4
"""... nor is the centre of mass of a flat shard lower over it [m]."""


class FloorPenetration:
    """Measures many bodies at once; their hull vertices are gathered again only when the bodies change."""

    def __init__(self, floor: float) -> None:
        """`floor`: height of its top [m]."""
        self._floor = floor
        self._numbers: tuple[int, ...] = ()
        self._vertices = np.zeros((0, 3))
        self._counts = np.zeros(0, dtype=np.int64)
        self._radii = np.zeros(0)

    def corrections(self, bodies: Sequence[RigidBody], states: Sequence[BodyState]) -> Floats:
        """How far each body has to be raised [m], shape (n,); zero or less where it stands well."""
        if not bodies:
            return np.zeros(0)
        lowest, centres = self._heights(bodies, states)
        return np.maximum(self._floor - lowest - PENETRATION_SLOP, self._floor + MIN_CENTRE_HEIGHT - centres)

    def _heights(self, bodies: Sequence[RigidBody], states: Sequence[BodyState]) -> tuple[Floats, Floats]:
        """Heights above z = 0 of the lowest point and of the centre of mass of each body [m], shape (n,) each. A body
        without hulls is a ball about its origin."""
        self._gather(bodies)
        w, x, y, z = np.array([state.quat_wxyz for state in states]).T
        up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)  # in the mesh frame
        heights = np.einsum("nk,nk->n", self._vertices, np.repeat(up, self._counts, axis=0))
        starts = np.concatenate([[0], np.cumsum(self._counts)[:-1]])
        origins = np.array([state.position[2] for state in states])
        centres = np.array([body.mass.centre for body in bodies])
        lowest = np.minimum.reduceat(heights, starts) + origins - self._radii
        return lowest, np.einsum("nk,nk->n", centres, up) + origins

    def _gather(self, bodies: Sequence[RigidBody]) -> None:
        numbers = tuple(body.number for body in bodies)
        if numbers == self._numbers:
            return
        self._numbers = numbers
        hulls = [body.hulls or (np.zeros((1, 3)),) for body in bodies]
        self._vertices = np.concatenate([points for parts in hulls for points in parts])
        self._counts = np.array([sum(len(points) for points in parts) for parts in hulls])
        self._radii = np.array([0.0 if body.hulls else body.radius for body in bodies])
