"""From the decoder's channels to a GS-SDF: where each voxel belongs, and how far the nearest crack is.

Outside and towards the surface nothing is predicted: the shape's own distance is exact there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.types import Floats, Floats32, Grid, Ints, Volume

CRUMB = 30 / 64**3
"""Pieces below this share of the grid are noise of the network and join their surroundings."""
ROUNDS = 1
"""Times the distance is swept through the body in all eight directions."""


@dataclass(frozen=True, eq=False)
class Body:
    """The voxels inside a shape, as a padded grid whose border is outside."""

    grid: Grid
    surface: Floats32
    """Signed distance to the shape's surface [m], + inside, shape (r, r, r)."""
    voxels: tuple[Ints, Ints, Ints]
    """Indices of the voxels inside, shape (n,) each."""
    flat: Ints
    """The same in the flattened padded grid."""
    slot: NDArray[np.int32]
    """Number of the voxel in `flat`, or -1 outside, shape ((r + 2)^3,)."""
    sweeps: tuple[Ints, Ints, Ints, Ints]
    """`flat` in the order of four diagonal directions."""

    @staticmethod
    def of(grid: Grid, surface: Floats32) -> Body:
        i, j, k = np.nonzero(surface > 0)
        side = grid.resolution + 2
        flat = ((i + 1) * side + j + 1) * side + k + 1
        slot = np.full(side**3, -1, np.int32)
        slot[flat] = np.arange(len(flat))
        signs = ((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))
        first, second, third, fourth = (flat[np.lexsort((c * k, b * j, a * i))] for a, b, c in signs)
        return Body(grid, surface, (i, j, k), flat, slot, (first, second, third, fourth))

    @property
    def points(self) -> Floats:
        """Positions of the voxels inside [m], shape (n, 3)."""
        return self.grid.to_world(np.stack(self.voxels, axis=1))


def volume_of(body: Body, scores: Floats32) -> Volume:
    """The GS-SDF of channel scores at the voxels inside.

    Args:
        scores: A voxel belongs to the channel of the highest score, shape (n, channels).
    """
    side = body.grid.resolution + 2
    channel = np.full(side**3, -1, np.int16)
    channel[body.flat] = scores.argmax(axis=1)
    _sweep_crumbs(channel, body.flat, side, max(2, round(CRUMB * body.grid.resolution**3)))
    distance = _at_cracks(channel, scores, body.flat, body.slot, side)
    for _ in range(ROUNDS):
        for order in body.sweeps:
            _sweep(distance, order, side)
            _sweep(distance, order[::-1], side)
    values = body.surface.copy()
    values[body.voxels] = np.minimum(values[body.voxels], distance[body.flat] * body.grid.spacing)
    return Volume(body.grid, values)


@njit(cache=True)
def _sweep_crumbs(channel, flat, side, smallest):
    """Give connected pieces of fewer than `smallest` voxels to the channel that surrounds them most."""
    steps = (1, -1, side, -side, side * side, -side * side)
    seen = np.zeros(len(channel), np.bool_)
    stack = np.empty(len(flat), np.int64)
    votes = np.zeros(channel.max() + 1, np.int64)
    for start in flat:
        if seen[start]:
            continue
        mine, size, next_ = channel[start], 1, 0
        stack[0] = start
        seen[start] = True
        votes[:] = 0
        while next_ < size:
            voxel = stack[next_]
            next_ += 1
            for step in steps:
                beside = voxel + step
                if channel[beside] == mine:
                    if not seen[beside]:
                        seen[beside] = True
                        stack[size] = beside
                        size += 1
                elif channel[beside] >= 0:
                    votes[channel[beside]] += 1
        if size < smallest and votes.max() > 0:
            winner = votes.argmax()
            for n in range(size):
                channel[stack[n]] = winner


@njit(cache=True)
def _at_cracks(channel, scores, flat, slot, side):
    """Distance to the crack [voxels] for voxels beside one, large elsewhere.

    Along an edge the crack lies where the two channels are equal, linearly; crossings t along the axes
    are those of a plane at the distance (sum of 1 / t^2)^(-1/2)."""
    steps = (1, side, side * side)
    distance = np.full(len(channel), np.float32(1e6))
    for voxel in flat:
        mine = channel[voxel]
        here = slot[voxel]
        total = 0.0
        for step in steps:
            nearest = np.inf
            for beside in (voxel - step, voxel + step):
                other = channel[beside]
                if other < 0 or other == mine:
                    continue
                there = slot[beside]
                a = max(scores[here, mine] - scores[here, other], np.float32(0.0))
                b = max(scores[there, other] - scores[there, mine], np.float32(0.0))
                crossing = a / (a + b) if a + b > 0 else 0.5
                nearest = min(nearest, max(crossing, 1e-3))
            if nearest < np.inf:
                total += 1 / nearest**2
        if total > 0:
            distance[voxel] = 1 / np.sqrt(total)
    return distance


@njit(cache=True)
def _sweep(distance, order, side):
    """One pass of the eikonal equation |grad d| = 1 (Zhao 2005, fast sweeping), unit spacing."""
    for voxel in order:
        a = min(distance[voxel - 1], distance[voxel + 1])
        b = min(distance[voxel - side], distance[voxel + side])
        c = min(distance[voxel - side * side], distance[voxel + side * side])
        a, b = min(a, b), max(a, b)
        if c < a:
            a, b, c = c, a, b
        elif c < b:
            b, c = c, b
        best = a + 1
        if best > b:
            best = 0.5 * (a + b + np.sqrt(2 - (a - b) ** 2))
            if best > c:
                mean = (a + b + c) / 3
                best = mean + np.sqrt(max(0.0, (1 - (a * a + b * b + c * c)) / 3 + mean * mean))
        if best < distance[voxel]:
            distance[voxel] = best
