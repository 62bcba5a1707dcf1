"""The distance to a shape's surface, computed once for a shape that is hit again and again."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry import signed_distance
from deepfracture.progress import stage
from deepfracture.types import BadInput, Floats, Floats32, Grid, Shape

THINNEST = 0.02
"""Mean thickness [voxels] below which hardly a voxel centre lies in a body, so that no pattern can be drawn on them."""


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
        """Voxel centres in the body [m], shape (n, 3); too few for a pattern only where the shape is a fragment.

        Raises:
            BadInput: A whole shape is so thin that it runs between them.
        """
        points = self.grid.centres()[self(shape) > 0]
        if shape.whole is None:
            self._refuse_thin(shape, len(points))
        return points

    def _refuse_thin(self, shape: Shape, count: int) -> None:
        """A sheet of area A/2 and thickness t holds A t / 2 h^3 voxel centres of spacing h."""
        h, area = self.grid.spacing, float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
        thickness = 2 * count * h**3 / area
        if thickness < THINNEST * h:
            raise BadInput(
                f"{shape.name}: thinner than a voxel of {h:.3g} m (it is two metres long) and lost between them; "
                "raise --resolution, make it a solid, or check the file's units and coordinates"
            )
