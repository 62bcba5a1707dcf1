"""From the decoder's logits to a GS-SDF: the fragment of each voxel, and the distance to the nearest crack.

1. Label each voxel with the channel of the greatest logit; logits are B-splines on a coarse lattice (`lattice`).
2. Relabel small components, noise of the network, and mark the cut faces.
3. Beside a crack, the distance is that to the plane where two logits are equal; beyond, fast sweeping solves the
   eikonal equation (Zhao 2005).
4. Outside, and where the surface is nearer than a crack, the shape's own distance is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.learn.domain import VoxelDomain
from deepfracture.learn.partition.lattice import SplineLattice
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
class SplineDomain(VoxelDomain):
    """The voxels inside a shape, and the lattice on which functions over it are stored."""

    runs: NDArray[np.int32]
    """Voxels inside that follow each other along the last axis: i, j, first k, end k, shape (n, 4)."""
    plane_starts: Ints
    """First run of each i, and the end, shape (r + 1,)."""
    lattice: SplineLattice

    @staticmethod
    def of(grid: Grid, surface: Floats32) -> SplineDomain:
        surface = np.ascontiguousarray(surface, np.float32)
        runs = runs_inside(surface)
        plane_starts = np.searchsorted(runs[:, 0], np.arange(grid.resolution + 1))
        return SplineDomain(grid, surface, runs, plane_starts, SplineLattice.of(grid, surface))

    @property
    def nodes(self) -> Floats:
        """Where `decode_logits` needs the logits [m], shape (m, 3)."""
        return self.lattice.nodes


def decode_logits(domain: SplineDomain, logits: Floats32) -> Volume:
    """The GS-SDF of channel logits.

    Args:
        logits: Spline coefficients of the logits at `domain.nodes`, shape (m, channels). For smooth functions these
            are nearly, and for linear ones exactly, their values there; for sine waves they are the values times
            `SplineLattice.gain`.

    Raises:
        BadInput: There is not one row of logits for each node.
    """
    if logits.ndim != 2 or len(logits) != len(domain.nodes):
        raise BadInput(f"logits must have shape ({len(domain.nodes)}, channels), got {logits.shape}")
    logits = np.ascontiguousarray(logits, np.float32)
    r, lattice = domain.grid.resolution, domain.lattice
    labels = np.zeros((r + 2, r + 2, r + 2), np.int16)
    argmax = _node_argmax(logits)
    parallel_for(
        lambda first, last: _assign_labels(
            logits, argmax, lattice.cells, lattice.number, lattice.start, lattice.weights, domain.surface, labels,
            first, last,
        ),
        len(lattice.cells), least=512,
    )  # fmt: skip
    cuts, beside = _cracks(labels, domain.runs)
    runs = uncut_runs(domain.runs, cuts)
    if relabel_small_components(labels, runs, components_of_runs(runs, cuts), max(2, round(SMALL_COMPONENT * r**3))):
        cuts, beside = _cracks(labels, domain.runs)
    distance = np.full(labels.shape, np.float32(FAR))
    parallel_for(
        lambda first, last: _crack_distance(
            labels, logits, beside[first:last], lattice.number, lattice.cell, lattice.weights, distance
        ),
        len(beside), least=1024,
    )  # fmt: skip
    active = np.full(distance.size, False)
    spacing = np.float32(domain.grid.spacing)
    _fast_sweep(distance.reshape(-1), domain.surface, spacing, domain.runs, domain.plane_starts, beside, active)
    values = domain.surface.copy()
    parallel_for(
        lambda first, last: _take_minimum(values, distance, domain.runs[first:last], spacing),
        len(domain.runs), least=4096,
    )  # fmt: skip
    return Volume(domain.grid, values, cuts)


@njit(cache=True)
def _node_argmax(logits):
    """The greatest channel at each node, the first of equals, shape (m,)."""
    argmax = np.empty(len(logits), np.int16)
    for node in range(len(logits)):
        row = logits[node]
        greatest = 0
        for m in range(1, len(row)):
            if row[m] > row[greatest]:
                greatest = m
        argmax[node] = greatest
    return argmax


@njit(cache=True, nogil=True)
def _assign_labels(logits, argmax, cells, number, start, weights, surface, labels, first, last):
    """Label each voxel inside some cells with the channel of the greatest spline, plus 1.

    A spline lies between the least and the greatest of the coefficients that it depends on (convex hull property). So
    a channel whose coefficients are all below those of another has no voxel of the cell; mostly one is left."""
    margin = np.empty(logits.shape[1], np.float32)
    candidates = np.empty(logits.shape[1], np.int16)
    near = np.empty((3, 3, 3), np.float32)
    widest = np.diff(start).max()
    best = np.empty((widest, widest, widest), np.float32)
    for n in range(first, last):
        cell = cells[n, 0], cells[n, 1], cells[n, 2]
        low = start[cell[0]], start[cell[1]], start[cell[2]]
        high = start[cell[0] + 1], start[cell[1] + 1], start[cell[2] + 1]
        count = _candidates(logits, argmax, number, cell, margin, candidates)
        for x in range(low[0], high[0]):
            for y in range(low[1], high[1]):
                for z in range(low[2], high[2]):
                    if surface[x, y, z] > 0:
                        labels[x + 1, y + 1, z + 1] = candidates[0] + 1
        if count == 1:
            continue
        best[:] = -np.inf
        for m in range(count):
            for a in range(3):
                for b in range(3):
                    for c in range(3):
                        near[a, b, c] = logits[number[cell[0] + a, cell[1] + b, cell[2] + c], candidates[m]]
            _evaluate_spline(near, candidates[m] + 1, weights, low, high, best, surface, labels)


@njit(cache=True, nogil=True)
def _candidates(logits, argmax, number, cell, margin, candidates):
    """Write the channels that can be the greatest somewhere in the cell to `candidates`; returns how many.

    No channel exceeds that of the cell's central node at a node where it is the greatest too: mostly at all."""
    greatest = argmax[number[cell[0] + 1, cell[1] + 1, cell[2] + 1]]
    candidates[0] = greatest
    contested = False
    for a in range(3):
        for b in range(3):
            for c in range(3):
                node = number[cell[0] + a, cell[1] + b, cell[2] + c]
                if argmax[node] == greatest:
                    continue
                if not contested:
                    margin[:] = -np.inf
                    contested = True
                row = logits[node]
                bar = row[greatest]
                for m in range(len(row)):
                    over = row[m] - bar
                    margin[m] = over if over > margin[m] else margin[m]
    count = 1
    if contested:
        for m in range(len(margin)):
            if margin[m] > 0 and m != greatest:
                candidates[count] = m
                count += 1
    return count


@njit(cache=True, nogil=True)
def _evaluate_spline(near, label, weights, low, high, best, surface, labels):
    """Label the voxels of a cell where the spline with coefficients `near` exceeds `best`, one axis at a time."""
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
def _crack_distance(labels, logits, beside, number, cell, weights, distance):
    """Distance to the crack [voxels] for the voxels `beside` one.

    Along an edge the crack lies where the two channels are equal, linearly; crossings t along the axes
    are those of a plane at the distance (sum of 1 / t^2)^(-1/2)."""
    for n in range(len(beside)):
        i, j, k = beside[n]
        own = labels[i + 1, j + 1, k + 1]
        total = np.float32(0.0)
        known, margin = own, np.float32(0.0)
        for axis in range(3):
            nearest = np.float32(2.0)
            for step in (-1, 1):
                x, y, z = i + step * (axis == 0), j + step * (axis == 1), k + step * (axis == 2)
                other = labels[x + 1, y + 1, z + 1]
                if other == 0 or other == own:
                    continue
                if other != known:
                    known, margin = other, _margin(logits, number, cell, weights, own - 1, other - 1, i, j, k)
                opposite = _margin(logits, number, cell, weights, other - 1, own - 1, x, y, z)
                crossing = margin / (margin + opposite) if margin + opposite > 0 else np.float32(0.5)
                nearest = min(nearest, max(crossing, np.float32(NEAREST)))
            if nearest < 2:
                total += 1 / (nearest * nearest)
        distance[i + 1, j + 1, k + 1] = 1 / np.sqrt(total)


@njit(cache=True, nogil=True)
def _margin(logits, number, cell, weights, own, other, i, j, k):
    """By how much the logit of channel `own` exceeds that of `other` at voxel (i, j, k), at least 0."""
    value = np.float32(0.0)
    for a in range(3):
        for b in range(3):
            line = np.float32(0.0)
            for c in range(3):
                node = number[cell[i] + a, cell[j] + b, cell[k] + c]
                line += weights[k, c] * (logits[node, own] - logits[node, other])
            value += weights[i, a] * weights[j, b] * line
    return max(value, np.float32(0.0))


@njit(cache=True)
def _fast_sweep(distance, surface, spacing, runs, plane_starts, beside, active):
    """Solve the eikonal equation |grad d| = 1 from the voxels known (Zhao 2005, fast sweeping), unit spacing.

    Voxels nearer to the surface than to any crack by SLACK are left out: the shortest way from a crack to
    a voxel that needs its distance leads through none of them. A voxel none of whose neighbours has changed
    since its last visit is skipped (Bak, McLaughlin and Renzi 2010), which changes nothing but the time."""
    side = np.int64(surface.shape[0] + 2)
    last = len(plane_starts) - 2
    inverse = np.float32(1.0) / spacing
    lines = np.zeros(side * side, np.bool_)  # those that hold voxels `active`, which a neighbour may lower
    for n in range(len(beside)):
        line = (beside[n, 0] + 1) * side + beside[n, 1] + 1
        _activate(distance, line * side + beside[n, 2] + 1, line, side, active, lines)
    for sweep in range(4):
        for layer in range(last + 1):
            i = layer if sweep % 2 == 0 else last - layer
            for m in range(plane_starts[i], plane_starts[i + 1]):
                n = m if sweep in (0, 3) else plane_starts[i] + plane_starts[i + 1] - 1 - m
                line = (i + 1) * side + runs[n, 1] + 1
                if lines[line]:
                    start, near = line * side + 1, surface[i, runs[n, 1]]
                    for k in range(runs[n, 2], runs[n, 3]):
                        if active[start + k]:
                            _visit(distance, start + k, line, side, near[k] * inverse, active, lines)
                    for k in range(runs[n, 3] - 1, runs[n, 2] - 1, -1):
                        if active[start + k]:
                            _visit(distance, start + k, line, side, near[k] * inverse, active, lines)


@njit(cache=True, inline="always")
def _visit(distance, voxel, line, side, surface, active, lines):
    active[voxel] = False
    if _upwind_update(distance, voxel, side, surface):
        _activate(distance, voxel, line, side, active, lines)


@njit(cache=True, inline="always")
def _activate(distance, voxel, line, side, active, lines):
    """Mark the neighbours that are farther than `voxel` to be visited."""
    here = distance[voxel]
    for step, across in ((1, 0), (side, 1), (side * side, side)):
        if distance[voxel - step] > here:
            active[voxel - step] = lines[line - across] = True
        if distance[voxel + step] > here:
            active[voxel + step] = lines[line + across] = True


@njit(cache=True, inline="always")
def _upwind_update(distance, voxel, side, surface):
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
            discriminant = (np.float32(1.0) - (low * low + middle * middle + high * high)) * third + mean * mean
            best = mean + np.sqrt(max(np.float32(0.0), discriminant))
    if best < here:
        distance[voxel] = best
        return True
    return False


@njit(cache=True, nogil=True)
def _take_minimum(values, distance, runs, spacing):
    """Lower the distance to the surface [m] inside to that to the crack where that is smaller."""
    for n in range(len(runs)):
        i, j = runs[n, 0], runs[n, 1]
        for k in range(runs[n, 2], runs[n, 3]):
            crack = distance[i + 1, j + 1, k + 1] * spacing
            values[i, j, k] = crack if crack < values[i, j, k] else values[i, j, k]
