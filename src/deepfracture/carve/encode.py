"""From a fracture pattern to the GS-SDF that the network learns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepfracture.types import BadInput, FracturePattern, Labels, Volume

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
    return Volume(pattern.grid, values, cuts_of(pattern.labels) if cuts else None)


def cuts_of(labels: Labels) -> NDArray[np.uint8]:
    """Bits 1, 2, 4 where two labels meet at the face towards the next voxel along x, y, z; 0 is no label."""
    cuts = np.zeros(labels.shape, np.uint8)
    for axis in range(3):
        ahead, beyond = (np.moveaxis(labels, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        parted = (ahead != beyond) & (ahead > 0) & (beyond > 0)
        np.moveaxis(cuts, axis, 0)[:-1] |= (parted << axis).astype(np.uint8)
    return cuts
