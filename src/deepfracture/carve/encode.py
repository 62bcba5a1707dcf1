"""From a fracture pattern to the GS-SDF that the network learns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from deepfracture.types import BadInput, FracturePattern, Volume


def encode(pattern: FracturePattern, surface_distance: ArrayLike) -> Volume:
    """The GS-SDF of a pattern (paper, eq. 4).

    Inside, the distance to the nearest boundary of any fragment, so the smaller of the distances to
    the cracks and to the surface; outside, minus the distance to the original surface. Where the
    surface is the only boundary known (label 0 inside) its distance stands alone.

    Args:
        pattern: Labels and crack distances [m].
        surface_distance: Signed distance of the voxel centres to the original surface [m], positive
            inside, shape (r, r, r).

    Raises:
        BadInput: The distance has another shape than the pattern, or is not finite.
    """
    surface = np.asarray(surface_distance, np.float32)
    if surface.shape != pattern.grid.shape:
        raise BadInput(f"surface_distance must have shape {pattern.grid.shape}, got {surface.shape}")
    inside = (surface > 0) & (pattern.labels > 0)
    return Volume(pattern.grid, np.where(inside, np.minimum(pattern.distance, surface), surface))
