"""From the decoder's channels to a GS-SDF: where each voxel belongs, and how far the nearest crack is.

Outside and towards the surface nothing is predicted: the shape's own distance is exact there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.learn.domain import VoxelDomain
from deepfracture.learn.partition.lattice import Lattice
from deepfracture.runtime.parallel import parallel_for
from deepfracture.types import BadInput, Floats, Floats32, Grid, Ints, Volume
from deepfracture.voxels.components import components_of_runs, runs_inside, uncut_runs
from deepfracture.voxels.cut_faces import mark_cut_faces
from deepfracture.voxels.small_components import relabel_small_components

SMALL_COMPONENT = 30 / 64**3
"""Components below this share of the grid are noise of the network and join their surroundings."""
FAR = 1e6
"""Distance [voxels] to the crack before any is known."""
NEAREST = 1e-3
"""Least distance [voxels] to a crack: the sign of a GS-SDF says what is inside."""
SLACK = 1.0
"""Voxels by which crack distances are followed beyond the distance to the surface, which takes over there."""


@dataclass(frozen=True, eq=False)
class Body(VoxelDomain):
    """The voxels inside a shape, and the lattice that functions over it are read from."""

    runs: NDArray[np.int32]
    """Voxels inside that follow each other along the last axis: i, j, first k, end k, shape (n, 4)."""
    planes: Ints
    """First run of each i, and the end, shape (r + 1,)."""
    lattice: Lattice

    @staticmethod
    def of(grid: Grid, surface: Floats32) -> Body:
        surface = np.ascontiguousarray(surface, np.float32)
        runs = runs_inside(surface)
        planes = np.searchsorted(runs[:, 0], np.arange(grid.resolution + 1))
        return Body(grid, surface, runs, planes, Lattice.of(grid, surface))

    @property
    def nodes(self) -> Floats:
        """Where `volume_of` needs the scores [m], shape (m, 3)."""
        return self.lattice.nodes


def volume_of(body: Body, scores: Floats32) -> Volume:
    """The GS-SDF of channel scores.

    Args:
        scores: Coefficients at `body.nodes` of the splines whose greatest a voxel belongs to, shape
            (m, channels). For smooth functions these are nearly, and for linear ones exactly, their values
            there; for waves they are the values times `Lattice.gain`.

    Raises:
        BadInput: There is not one row of scores for each node.
    """
    if scores.ndim != 2 or len(scores) != len(body.nodes):
        raise BadInput(f"scores must have shape ({len(body.nodes)}, channels), got {scores.shape}")
    scores = np.ascontiguousarray(scores, np.float32)
    r, lattice = body.grid.resolution, body.lattice
    labels = np.zeros((r + 2, r + 2, r + 2), np.int16)
    leaders = _leaders(scores)
    parallel_for(
        lambda first, last: _divide(
            scores, leaders, lattice.cells, lattice.number, lattice.start, lattice.weights, body.surface, labels,
            first, last,
        ),
        len(lattice.cells), least=512,
    )  # fmt: skip
    cuts, beside = _cracks(labels, body.runs)
    runs = uncut_runs(body.runs, cuts)
    if relabel_small_components(labels, runs, components_of_runs(runs, cuts), max(2, round(SMALL_COMPONENT * r**3))):
        cuts, beside = _cracks(labels, body.runs)
    distance = np.full(labels.shape, np.float32(FAR))
    parallel_for(
        lambda first, last: _at_cracks(
            labels, scores, beside[first:last], lattice.number, lattice.cell, lattice.weights, distance
        ),
        len(beside), least=1024,
    )  # fmt: skip
    due = np.full(distance.size, False)
    _sweep(distance.reshape(-1), body.surface, np.float32(body.grid.spacing), body.runs, body.planes, beside, due)
    values = body.surface.copy()
    spacing = np.float32(body.grid.spacing)
    parallel_for(
        lambda first, last: _take_nearer(values, distance, body.runs[first:last], spacing), len(body.runs), least=4096
    )
    return Volume(body.grid, values, cuts)


@njit(cache=True)
def _leaders(scores):
    """The greatest channel at each node, the first of equals, shape (m,)."""
    leaders = np.empty(len(scores), np.int16)
    for node in range(len(scores)):
        row = scores[node]
        leader = 0
        for m in range(1, len(row)):
            if row[m] > row[leader]:
                leader = m
        leaders[node] = leader
    return leaders


@njit(cache=True, nogil=True)
def _divide(scores, leaders, cells, number, start, weights, surface, labels, first, last):
    """Give each voxel inside some cells to the channel of the greatest spline, as the label 1 above the channel.

    A spline lies between the least and the greatest of the coefficients that it depends on. So a channel
    whose coefficients are all below those of another has no voxel of the cell; mostly one is left."""
    ahead = np.empty(scores.shape[1], np.float32)
    rivals = np.empty(scores.shape[1], np.int16)
    near = np.empty((3, 3, 3), np.float32)
    widest = np.diff(start).max()
    best = np.empty((widest, widest, widest), np.float32)
    for n in range(first, last):
        cell = cells[n, 0], cells[n, 1], cells[n, 2]
        low = start[cell[0]], start[cell[1]], start[cell[2]]
        high = start[cell[0] + 1], start[cell[1] + 1], start[cell[2] + 1]
        count = _rivals(scores, leaders, number, cell, ahead, rivals)
        for x in range(low[0], high[0]):
            for y in range(low[1], high[1]):
                for z in range(low[2], high[2]):
                    if surface[x, y, z] > 0:
                        labels[x + 1, y + 1, z + 1] = rivals[0] + 1
        if count == 1:
            continue
        best[:] = -np.inf
        for m in range(count):
            for a in range(3):
                for b in range(3):
                    for c in range(3):
                        near[a, b, c] = scores[number[cell[0] + a, cell[1] + b, cell[2] + c], rivals[m]]
            _raise(near, rivals[m] + 1, weights, low, high, best, surface, labels)


@njit(cache=True, nogil=True)
def _rivals(scores, leaders, number, cell, ahead, rivals):
    """Channels that can be the greatest somewhere in the cell, in `rivals`; returns how many.

    Nothing is ahead of the leader of the cell at a node where it leads too, and mostly it leads at all."""
    leader = leaders[number[cell[0] + 1, cell[1] + 1, cell[2] + 1]]
    rivals[0] = leader
    contested = False
    for a in range(3):
        for b in range(3):
            for c in range(3):
                node = number[cell[0] + a, cell[1] + b, cell[2] + c]
                if leaders[node] == leader:
                    continue
                if not contested:
                    ahead[:] = -np.inf
                    contested = True
                row = scores[node]
                bar = row[leader]
                for m in range(len(row)):
                    over = row[m] - bar
                    ahead[m] = over if over > ahead[m] else ahead[m]
    count = 1
    if contested:
        for m in range(len(ahead)):
            if ahead[m] > 0 and m != leader:
                rivals[count] = m
                count += 1
    return count


@njit(cache=True, nogil=True)
def _raise(near, label, weights, low, high, best, surface, labels):
    """Give the voxels of a cell where the spline `near` is above `best` to its label, an axis at a time."""
    plane = np.empty((3, 3), np.float32)
    for x in range(low[0], high[0]):
        for b in range(3):
            for c in range(3):
                plane[b, c] = (
                    weights[x, 0] * near[0, b, c] + weights[x, 1] * near[1, b, c] + weights[x, 2] * near[2, b, c]
                )
        for y in range(low[1], high[1]):
            u, v, w = weights[y, 0], weights[y, 1], weights[y, 2]
            first = u * plane[0, 0] + v * plane[1, 0] + w * plane[2, 0]
            second = u * plane[0, 1] + v * plane[1, 1] + w * plane[2, 1]
            third = u * plane[0, 2] + v * plane[1, 2] + w * plane[2, 2]
            for z in range(low[2], high[2]):
                value = weights[z, 0] * first + weights[z, 1] * second + weights[z, 2] * third
                if value > best[x - low[0], y - low[1], z - low[2]]:
                    best[x - low[0], y - low[1], z - low[2]] = value
                    if surface[x, y, z] > 0:
                        labels[x + 1, y + 1, z + 1] = label


def _cracks(labels: NDArray[np.int16], runs: NDArray[np.int32]) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """The faces that cracks cut, as in `Volume.cuts`, and the voxels inside that have one, shape (n, 3)."""
    cuts = np.zeros([size - 2 for size in labels.shape], np.uint8)
    return cuts, np.concatenate(
        parallel_for(lambda first, last: _mark_cracks(labels, runs[first:last], cuts), len(runs), least=1024)
    )


@njit(cache=True, nogil=True)
def _mark_cracks(labels, runs, cuts):
    """Mark the `cuts` (zero on entry); returns the voxels inside that have one, shape (n, 3)."""
    beside = np.empty((np.sum(runs[:, 3] - runs[:, 2]), 3), np.int32)
    found = np.empty(cuts.shape[2], np.uint8)
    count = 0
    for n in range(len(runs)):
        i, j, first, end = runs[n, 0], runs[n, 1], runs[n, 2], runs[n, 3]
        line = labels[i + 1, j + 1, first + 1 : end + 1]
        bits = cuts[i, j, first:end]
        mark_cut_faces(line, labels[i + 2, j + 1, first + 1 : end + 1], bits, 1)
        mark_cut_faces(line, labels[i + 1, j + 2, first + 1 : end + 1], bits, 2)
        mark_cut_faces(line, labels[i + 1, j + 1, first + 2 : end + 2], bits, 4)
        found[: end - first] = bits
        mark_cut_faces(line, labels[i, j + 1, first + 1 : end + 1], found, 1)
        mark_cut_faces(line, labels[i + 1, j, first + 1 : end + 1], found, 2)
        mark_cut_faces(line, labels[i + 1, j + 1, first:end], found, 4)
        for k in range(first, end):
            if found[k - first]:
                beside[count, 0], beside[count, 1], beside[count, 2] = i, j, k
                count += 1
    return beside[:count].copy()


@njit(cache=True, nogil=True)
def _at_cracks(labels, scores, beside, number, cell, weights, distance):
    """Distance to the crack [voxels] for the voxels `beside` one.

    Along an edge the crack lies where the two channels are equal, linearly; crossings t along the axes
    are those of a plane at the distance (sum of 1 / t^2)^(-1/2)."""
    for n in range(len(beside)):
        i, j, k = beside[n]
        mine = labels[i + 1, j + 1, k + 1]
        total = np.float32(0.0)
        known, ahead = mine, np.float32(0.0)
        for axis in range(3):
            nearest = np.float32(2.0)
            for step in (-1, 1):
                x, y, z = i + step * (axis == 0), j + step * (axis == 1), k + step * (axis == 2)
                other = labels[x + 1, y + 1, z + 1]
                if other == 0 or other == mine:
                    continue
                if other != known:
                    known, ahead = other, _ahead(scores, number, cell, weights, mine - 1, other - 1, i, j, k)
                behind = _ahead(scores, number, cell, weights, other - 1, mine - 1, x, y, z)
                crossing = ahead / (ahead + behind) if ahead + behind > 0 else np.float32(0.5)
                nearest = min(nearest, max(crossing, np.float32(NEAREST)))
            if nearest < 2:
                total += 1 / (nearest * nearest)
        distance[i + 1, j + 1, k + 1] = 1 / np.sqrt(total)


@njit(cache=True, nogil=True)
def _ahead(scores, number, cell, weights, mine, other, i, j, k):
    """By how much channel `mine` is above `other` at voxel (i, j, k), 0 if it is not."""
    value = np.float32(0.0)
    for a in range(3):
        for b in range(3):
            line = np.float32(0.0)
            for c in range(3):
                node = number[cell[i] + a, cell[j] + b, cell[k] + c]
                line += weights[k, c] * (scores[node, mine] - scores[node, other])
            value += weights[i, a] * weights[j, b] * line
    return max(value, np.float32(0.0))


@njit(cache=True)
def _sweep(distance, surface, spacing, runs, planes, beside, due):
    """Solve the eikonal equation |grad d| = 1 from the voxels known (Zhao 2005, fast sweeping), unit spacing.

    Voxels nearer to the surface than to any crack by SLACK are left out: the shortest way from a crack to
    a voxel that needs its distance leads through none of them. A voxel none of whose neighbours has changed
    since its last turn is passed over (Bak, McLaughlin and Renzi 2010), which changes nothing but the time."""
    side = np.int64(surface.shape[0] + 2)
    last = len(planes) - 2
    inverse = np.float32(1.0) / spacing
    lines = np.zeros(side * side, np.bool_)  # those that hold voxels `due`, which a neighbour may lower
    for n in range(len(beside)):
        line = (beside[n, 0] + 1) * side + beside[n, 1] + 1
        _announce(distance, line * side + beside[n, 2] + 1, line, side, due, lines)
    for turn in range(4):
        for layer in range(last + 1):
            i = layer if turn % 2 == 0 else last - layer
            for m in range(planes[i], planes[i + 1]):
                n = m if turn in (0, 3) else planes[i] + planes[i + 1] - 1 - m
                line = (i + 1) * side + runs[n, 1] + 1
                if lines[line]:
                    start, near = line * side + 1, surface[i, runs[n, 1]]
                    for k in range(runs[n, 2], runs[n, 3]):
                        if due[start + k]:
                            _take_turn(distance, start + k, line, side, near[k] * inverse, due, lines)
                    for k in range(runs[n, 3] - 1, runs[n, 2] - 1, -1):
                        if due[start + k]:
                            _take_turn(distance, start + k, line, side, near[k] * inverse, due, lines)


@njit(cache=True, inline="always")
def _take_turn(distance, voxel, line, side, surface, due, lines):
    due[voxel] = False
    if _update(distance, voxel, side, surface):
        _announce(distance, voxel, line, side, due, lines)


@njit(cache=True, inline="always")
def _announce(distance, voxel, line, side, due, lines):
    """Let the neighbours that are farther than `voxel` have their turn."""
    here = distance[voxel]
    for step, across in ((1, 0), (side, 1), (side * side, side)):
        if distance[voxel - step] > here:
            due[voxel - step] = lines[line - across] = True
        if distance[voxel + step] > here:
            due[voxel + step] = lines[line + across] = True


@njit(cache=True, inline="always")
def _update(distance, voxel, side, surface):
    a = min(distance[voxel - 1], distance[voxel + 1])
    b = min(distance[voxel - side], distance[voxel + side])
    c = min(distance[voxel - side * side], distance[voxel + side * side])
    here = distance[voxel]
    low = min(a, b, c)
    if low >= here or low > surface + np.float32(SLACK):
        return False
    high = max(a, b, c)
    middle = max(min(a, b), min(max(a, b), c))
    best = low + np.float32(1.0)
    if best > middle:
        best = np.float32(0.5) * (low + middle + np.sqrt(np.float32(2.0) - (low - middle) ** 2))
        if best > high:
            third = np.float32(1 / 3)
            mean = (low + middle + high) * third
            parallel_for = (np.float32(1.0) - (low * low + middle * middle + high * high)) * third + mean * mean
            best = mean + np.sqrt(max(np.float32(0.0), parallel_for))
    if best < here:
        distance[voxel] = best
        return True
    return False


@njit(cache=True, nogil=True)
def _take_nearer(values, distance, runs, spacing):
    """Lower the distance to the surface [m] inside to that to the crack where that is smaller."""
    for n in range(len(runs)):
        i, j = runs[n, 0], runs[n, 1]
        for k in range(runs[n, 2], runs[n, 3]):
            crack = distance[i + 1, j + 1, k + 1] * spacing
            values[i, j, k] = crack if crack < values[i, j, k] else values[i, j, k]
