"""From a fracture pattern to the GS-SDF that the network learns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from deepfracture.types import BadInput, FracturePattern, Volume
from deepfracture.voxels import cut_faces

ON_CRACK = np.float32(1e-6)
"""Least value inside [m]: a voxel whose centre lies on a crack is still inside."""


def encode(pattern: FracturePattern, surface_distance: ArrayLike, *, cuts: bool = True) -> Volume:
    """The GS-SDF of a pattern (paper, eq. 4), and the faces between voxels that its cracks cut.

    Inside, the distance to the nearest boundary of any fragment, so the smaller of the distances to
    the cracks and to the surface; outside, minus the distance to the original surface. Where the
    surface is the only boundary known (label 0 inside) its distance stands alone.

    Args:
        pattern: Labels and crack distances [m].
        surface_distance: Signed distance of the voxel centres to the original surface [m], positive
            inside, shape (r, r, r).
        cuts: Without them the volume is the paper's, and `segment` has to guess from the distances.

    Raises:
        BadInput: The distance has another shape than the pattern, or is not finite.
    """
    surface = np.asarray(surface_distance, np.float32)
    if surface.shape != pattern.grid.shape:
        raise BadInput(f"surface_distance must have shape {pattern.grid.shape}, got {surface.shape}")
    inside = (surface > 0) & (pattern.labels > 0)
    values = np.where(inside, np.maximum(np.minimum(pattern.distance, surface), ON_CRACK), surface)
    return Volume(pattern.grid, values, cut_faces(pattern.labels) if cuts else None)
