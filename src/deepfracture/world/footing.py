"""How deep bodies stand in the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from deepfracture.types import Floats
from deepfracture.world.engine import Motion


class Footed(Protocol):
    """A body with corners."""

    @property
    def number(self) -> int: ...
    @property
    def hulls(self) -> tuple[Floats, ...]: ...


class Footing:
    """Lowest corners of many bodies at once; they are gathered again only where the bodies are others than before."""

    def __init__(self) -> None:
        self._numbers: tuple[int, ...] = ()
        self._corners = np.zeros((0, 3))
        self._counts = np.zeros(0, dtype=np.int64)

    def lowest(self, bodies: Sequence[Footed], motions: Sequence[Motion]) -> Floats:
        """Height of the lowest corner of each body above z = 0 [m], shape (n,). Every body has a hull."""
        if not bodies:
            return np.zeros(0)
        self._gather(bodies)
        w, x, y, z = np.array([motion.quat_wxyz for motion in motions]).T
        down = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
        heights = np.einsum("nk,nk->n", self._corners, np.repeat(down, self._counts, axis=0))
        starts = np.concatenate([[0], np.cumsum(self._counts)[:-1]])
        return np.minimum.reduceat(heights, starts) + np.array([motion.position[2] for motion in motions])

    def _gather(self, bodies: Sequence[Footed]) -> None:
        numbers = tuple(body.number for body in bodies)
        if numbers == self._numbers:
            return
        self._numbers = numbers
        self._corners = np.concatenate([points for body in bodies for points in body.hulls])
        self._counts = np.array([sum(len(points) for points in body.hulls) for body in bodies])
