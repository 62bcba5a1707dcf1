"""The distance to a shape's surface, computed once for a shape that is hit again and again."""

from __future__ import annotations

from deepfracture.geometry import signed_distance
from deepfracture.progress import stage
from deepfracture.types import BadInput, Floats, Floats32, Grid, Shape


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

    def inside(self, shape: Shape) -> Floats:
        """Voxel centres in the body [m], shape (n, 3); none at all only where the shape is a fragment.

        Raises:
            BadInput: A whole shape is so thin that it runs between them.
        """
        points = self.grid.centres()[self(shape) > 0]
        if not len(points) and shape.whole is None:
            raise BadInput(
                f"{shape.name}: thinner than a voxel of {self.grid.spacing:.3g} m everywhere (it is two metres long); "
                "raise --resolution, or check the file's units and coordinates"
            )
        return points
