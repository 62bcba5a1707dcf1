"""The distance to a shape's surface, computed once for a shape that is hit again and again."""

from __future__ import annotations

from deepfracture.geometry import signed_distance
from deepfracture.progress import stage
from deepfracture.types import Floats32, Grid, Shape


class Surface:
    """Remembers the shape that it saw last, and no other: fragments that break again come by the hundred."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self._last: tuple[Shape, Floats32] | None = None

    def __call__(self, shape: Shape) -> Floats32:
        """Signed distance of the voxel centres [m], positive inside, shape (r, r, r)."""
        if self._last is None or self._last[0] is not shape:
            with stage("distance field"):
                self._last = shape, signed_distance(shape.mesh, self.grid)
        return self._last[1]
