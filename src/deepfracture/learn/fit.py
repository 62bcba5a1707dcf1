"""Whether a shape is the one that a model was trained on."""

from __future__ import annotations

import numpy as np

from deepfracture.learn.partition.field import Body
from deepfracture.types import Shape

SAME_SURFACE = 0.5
"""Voxels by which distances to the surface of one shape may differ: another tessellation, stored precision."""


def fits(body: Body, shape: Shape) -> bool:
    """Whether `shape` has the surface that `body` stores, however it is tessellated."""
    from deepfracture.geometry import signed_distance_points

    grid = body.grid
    voxels = np.argwhere(np.abs(body.surface) < 4 * grid.spacing)[:: max(1, body.surface.size // 10**5)]
    found = signed_distance_points(shape.mesh, grid.to_world(voxels))
    return bool(np.percentile(np.abs(found - body.surface[tuple(voxels.T)]), 99) < SAME_SURFACE * grid.spacing)
