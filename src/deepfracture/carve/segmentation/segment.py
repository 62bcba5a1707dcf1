"""From a GS-SDF to fragments: cut faces where they are known, else a watershed (paper, section 5.2)."""

from __future__ import annotations

import numpy as np

from deepfracture.carve.segmentation.watershed import watershed
from deepfracture.types import BadInput, FracturePattern, Volume
from deepfracture.voxels import components_of_at_least

BAND = 0.03
"""Depth [m] of the band outside the zero level that the watershed includes (the paper's epsilon)."""


def segment(volume: Volume, *, tolerance: float = 0.5, min_voxels: int = 8) -> FracturePattern:
    """Segmentation of a GS-SDF into fragments.

    Where the cut faces are known, fragments are the components that they separate, whatever the values
    (`components_of_at_least`). Otherwise the values decide:

    Voxels are taken from the highest value down. A peak starts a region; where two regions meet, at
    the pass between them, the one with the lower peak joins the other if it is shallow (its peak rises
    above the pass by less than `tolerance` of the peak's own height) or has fewer than `min_voxels`
    voxels; otherwise they stay separate for good, without a dam between them. Depth is measured against
    the peak, not in metres as in the paper, because a crack's pass lies near zero whatever the size of
    the fragment, while the necks inside one fragment scale with it. A voxel joins the region of its
    steepest higher neighbour.

    As in the paper (caged segmentation), a band of thickness BAND outside the zero level takes part: it
    connects thin parts, whose voxels are badly connected, to the fragment they belong to. The labels
    themselves end at the zero level.

    Args:
        volume: The GS-SDF; predicted ones may be blurred.
        tolerance: Relative depth, 0 to 1: higher merges more.
        min_voxels: Smallest fragment, unless it touches no other.

    Returns:
        Labels 1..n where the value is positive. Its `distance` is the value itself, the distance to the
        nearest boundary: to the crack near cracks, but to the surface near the surface.

    Raises:
        BadInput: tolerance or min_voxels is out of range.
    """
    if not 0 <= tolerance < 1:
        raise BadInput(f"tolerance must lie in [0, 1), got {tolerance}")
    if min_voxels < 0:
        raise BadInput(f"min_voxels must be zero or more, got {min_voxels}")
    if volume.cuts is not None:
        labels = components_of_at_least(volume.values, volume.cuts, min_voxels)
        return FracturePattern(volume.grid, labels, np.maximum(volume.values, 0))
    labels = watershed(volume.values, volume.grid.spacing, -BAND, tolerance, min_voxels)
    return FracturePattern(volume.grid, labels, np.maximum(volume.values, 0))
