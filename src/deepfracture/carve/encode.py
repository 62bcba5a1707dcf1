"""From a fracture pattern to the GS-SDF that the network learns."""

from __future__ import annotations

import numpy as np
from numba import njit
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
    return _cuts(np.ascontiguousarray(labels))


@njit(cache=True)
def _cuts(labels: np.ndarray) -> np.ndarray:
    n0, n1, n2 = labels.shape
    cuts = np.zeros((n0, n1, n2), np.uint8)
    for i in range(n0):
        for j in range(n1):
            line, bits = labels[i, j], cuts[i, j]
            if i + 1 < n0:
                mark_parted(line, labels[i + 1, j], bits, 1)
            if j + 1 < n1:
                mark_parted(line, labels[i, j + 1], bits, 2)
            mark_parted(line[: n2 - 1], line[1:], bits, 4)
    return cuts


@njit(cache=True, inline="always")
def mark_parted(here: np.ndarray, there: np.ndarray, bits: np.ndarray, bit: int) -> None:
    """Set `bit` where two lines of labels have one each, and not the same."""
    for k in range(len(here)):
        parted = (here[k] != there[k]) & (here[k] > 0) & (there[k] > 0)
        bits[k] |= np.uint8(parted) * np.uint8(bit)
