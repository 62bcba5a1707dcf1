"""How deep bodies stand in the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from deepfracture.types import Floats
from deepfracture.world.engine import Mass, Motion


class Footed(Protocol):
    """A body with corners, or a ball."""

    @property
    def number(self) -> int: ...
    @property
    def hulls(self) -> tuple[Floats, ...]: ...
    @property
    def mass(self) -> Mass: ...
    @property
    def radius(self) -> float: ...


class Footing:
    """Lowest corners of many bodies at once; they are gathered again only where the bodies are others than before."""

    def __init__(self) -> None:
        self._numbers: tuple[int, ...] = ()
        self._corners = np.zeros((0, 3))
        self._counts = np.zeros(0, dtype=np.int64)
        self._reach = np.zeros(0)

    def heights(self, bodies: Sequence[Footed], motions: Sequence[Motion]) -> tuple[Floats, Floats]:
        """Heights above z = 0 of the lowest point and of the centre of mass of each body [m], shape (n,) each. What has
        no hulls is a ball about its origin."""
        if not bodies:
            return np.zeros(0), np.zeros(0)
        self._gather(bodies)
        w, x, y, z = np.array([motion.quat_wxyz for motion in motions]).T
        down = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
        heights = np.einsum("nk,nk->n", self._corners, np.repeat(down, self._counts, axis=0))
        starts = np.concatenate([[0], np.cumsum(self._counts)[:-1]])
        origin = np.array([motion.position[2] for motion in motions])
        centres = np.array([body.mass.centre for body in bodies])
        lowest = np.minimum.reduceat(heights, starts) + origin - self._reach
        return lowest, np.einsum("nk,nk->n", centres, down) + origin

    def _gather(self, bodies: Sequence[Footed]) -> None:
        numbers = tuple(body.number for body in bodies)
        if numbers == self._numbers:
            return
        self._numbers = numbers
        corners = [body.hulls or (np.zeros((1, 3)),) for body in bodies]
        self._corners = np.concatenate([points for hulls in corners for points in hulls])
        self._counts = np.array([sum(len(points) for points in hulls) for hulls in corners])
        self._reach = np.array([0.0 if body.hulls else body.radius for body in bodies])
