"""The voxels inside a shape, cached for a shape that is hit repeatedly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deepfracture.geometry import voxels_inside
from deepfracture.runtime.progress import stage
from deepfracture.types import BadInput, Floats, Grid, Shape

THINNEST = 0.02
"""Mean thickness [voxels] below which hardly a voxel centre lies in a body, so that no pattern can be drawn on them."""


class InsideMask:
    """Keeps the mask of the last shape only: fragments that break again come by the hundred."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self._last: tuple[Shape, NDArray[np.bool_]] | None = None

    def __call__(self, shape: Shape) -> NDArray[np.bool_]:
        """Whether each voxel centre lies in the body, shape (r, r, r); hardly any only where it is a fragment.

        Raises:
            BadInput: A whole shape is so thin that it runs between them.
        """
        if self._last is None or self._last[0] is not shape:
            with stage("voxels inside"):
                inside = voxels_inside(shape.mesh, self.grid)
                if shape.whole is None:
                    self._refuse_thin(shape, int(inside.sum()))
                self._last = shape, inside
        return self._last[1]

    def points(self, shape: Shape) -> Floats:
        """Voxel centres in the body [m], shape (n, 3); as `__call__`."""
        return self.grid.to_world(np.argwhere(self(shape)))

    def _refuse_thin(self, shape: Shape, count: int) -> None:
        """A sheet of area A/2 and thickness t holds A t / 2 h^3 voxel centres of spacing h."""
        h, area = self.grid.spacing, float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
        thickness = 2 * count * h**3 / area
        if thickness < THINNEST * h:
            raise BadInput(
                f"{shape.name}: thinner than a voxel of {h:.3g} m (it is two metres long) and lost between them; "
                "raise --resolution, make it a solid, or check the file's units and coordinates"
            )
