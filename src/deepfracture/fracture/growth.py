"""Growth of one crack: its front marches over the zero level set of a potential, in the order of arrival.

The march is a fast marching method (Sethian 1996) over the voxels within a narrow band of the level set: a heap of
arrival times, in which each accepted voxel offers itself to its neighbours. In place of an eikonal solve, a voxel's
time is that of its earliest accepted neighbour plus the distance over the front's speed there. The speed follows from
the stress intensity K_I of a penny crack (Sneddon 1946) in the tension across the surface, with corrections for bending
and free surfaces (Tada), against the local toughness: the front advances once the rising load makes K_I exceed it
(Irwin 1957, K_I = K_Ic), at the speed of Freund (1990). It stops where K_I at peak load does not reach the toughness,
at the surface, and at faces that earlier cracks have cut, in T-junctions.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numba import njit

from deepfracture.fracture.padded_grid import PaddedGrid, interpolate
from deepfracture.types import Floats, Floats32, Ints

BAND = 1.5
"""Half width of the narrow band around the level set [voxels]."""
OVERSHOOT = 1.8
"""How far a front runs past the surface [voxels], so that no voxel inside is left uncut."""
FREE_SURFACE_LIMIT = 2.5
"""Upper bound of the free-surface factor of the stress intensity (fitted for a/R up to 0.7, where it is 1.5)."""
NUCLEUS = 2.0
"""Radius within which a crack opens instantly [voxels]; the grid does not resolve a smaller front."""
FRONT, STOPPED = 1, 2


class Crack(NamedTuple):
    """The voxels that one crack front has passed."""

    voxels: Ints
    """Their indices on the fine grid, shape (n, 3)."""
    offset: Floats
    """Signed distance of the voxel's centre to the crack surface [m], shape (n,)."""
    normals: Floats
    """Unit normal of the crack surface, shape (n, 3)."""
    arrival: Floats
    """When the front passed [s since first contact], shape (n,)."""


class MarchState(NamedTuple):
    """Fields of a march over the fine grid, shape (n, n, n); all but `cut` are zero between cracks."""

    status: np.ndarray
    """0, FRONT or STOPPED."""
    arrival: Floats32
    """[s]"""
    mouth: Floats32
    """Tension that opens the wall here [Pa]."""
    drive: Floats32
    """Its mean along the path of the front [Pa]."""
    cut: np.ndarray
    """Faces that cracks have cut, one bit per axis (towards the next voxel)."""

    @staticmethod
    def on(grid: PaddedGrid) -> MarchState:
        arrival, mouth, drive = (np.zeros(grid.shape, np.float32) for _ in range(3))
        return MarchState(np.zeros(grid.shape, np.uint8), arrival, mouth, drive, np.zeros(grid.shape, np.uint8))

    def clear(self, crack: Crack) -> None:
        """Reset the fields where `crack` has run."""
        cells = tuple(crack.voxels.T)
        for scratch in (self.status, self.arrival, self.mouth, self.drive):
            scratch[cells] = 0


class LoadRamp(NamedTuple):
    """The load rises linearly to its peak; a crack runs at most at the Rayleigh wave speed."""

    rise: float
    """Time from first contact to peak load [s]."""
    speed: float
    """[m/s]"""
    max_length: float
    """Crack length beyond which the stress intensity no longer grows: the size of the body [m]."""


class MarchFields(NamedTuple):
    """What determines the growth of a crack."""

    sdf: Floats32
    """Signed distance to the surface on the fine grid [m], shape (n, n, n)."""
    thickness: Floats32
    """Local wall thickness on the coarse grid [m], shape (m, m, m)."""
    stress: Floats32
    """Driving stress at peak load on the coarse grid [Pa], shape (6, m, m, m)."""
    level_set: Floats32
    """Potential whose zero level set is the crack surface, on the coarse grid [m], shape (m, m, m)."""
    toughness: Floats32
    """On the coarse grid [Pa sqrt(m)], shape (m, m, m)."""


@njit(cache=True)
def _value_and_gradient(level_set, x, y, z, step):
    """The potential and its gradient at a fractional coarse index (gradient per index)."""
    p = interpolate(level_set, x, y, z)
    gx = (interpolate(level_set, x + step, y, z) - interpolate(level_set, x - step, y, z)) / (2 * step)
    gy = (interpolate(level_set, x, y + step, z) - interpolate(level_set, x, y - step, z)) / (2 * step)
    gz = (interpolate(level_set, x, y, z + step) - interpolate(level_set, x, y, z - step)) / (2 * step)
    return p, gx, gy, gz


@njit(cache=True)
def _opening_stress(stress, x, y, z, nx, ny, nz):
    """n . sigma . n at a fractional coarse index."""
    sxx = interpolate(stress[0], x, y, z)
    syy = interpolate(stress[1], x, y, z)
    szz = interpolate(stress[2], x, y, z)
    syz = interpolate(stress[3], x, y, z)
    sxz = interpolate(stress[4], x, y, z)
    sxy = interpolate(stress[5], x, y, z)
    return sxx * nx * nx + syy * ny * ny + szz * nz * nz + 2 * (syz * ny * nz + sxz * nx * nz + sxy * nx * ny)


@njit(cache=True)
def _parent(status, arrival, i, j, k):
    """The earliest accepted neighbour: its arrival time and index offset; infinite without one."""
    best, bi, bj, bk = np.inf, 0, 0, 0
    for di in range(-1, 2):
        for dj in range(-1, 2):
            for dk in range(-1, 2):
                if status[i + di, j + dj, k + dk] == FRONT and arrival[i + di, j + dj, k + dk] < best:
                    best, bi, bj, bk = arrival[i + di, j + dj, k + dk], di, dj, dk
    return best, bi, bj, bk


class _Step(NamedTuple):
    """An advance of the front to a voxel from its earliest neighbour."""

    came: float
    """Arrival time at the neighbour [s]."""
    mouth: float
    """Tension that opens the wall at the neighbour [Pa] ..."""
    drive: float
    """... and its mean along the path so far [Pa]."""
    length: float
    """Distance from the neighbour [m]."""
    tension: float
    """Tension across the crack surface at the voxel [Pa]."""
    thickness: float
    """Of the wall [m]."""
    radius: float
    """Crack length: distance from the seed [m]."""
    depth: float
    """Distance to the free surface [m]."""
    toughness: float
    """[Pa sqrt(m)]"""


@njit(cache=True)
def _advance(step, ramp):
    """Arrival time at the voxel (inf: never), the tension that opens the wall there, and its mean along the path."""
    # The tension at a crack's mouth drives it through the wall although the far side is compressed:
    # under bending K_I of an edge crack never falls below that of the surface stress (Tada 2.13).
    opening = max(step.tension, step.mouth * np.exp(-step.length / step.thickness))
    # Along the wall K_I weighs the tension over the whole crack, not at its front alone (Tada 5.11).
    drive = step.drive + (opening - step.drive) * min(step.length / step.radius, 1.0)
    if drive <= 0:
        return np.inf, opening, drive
    near = step.radius / (step.radius + max(step.depth, 0.0))
    free_surface = min(1 / (1 - min(near * near * near, 0.9)), FREE_SURFACE_LIMIT)
    # Sneddon 1946: penny crack, K_I = 2 sigma sqrt(a / pi); then the free-surface factor
    intensity = 2 * drive * np.sqrt(min(step.radius, ramp.max_length) / np.pi) * free_surface
    critical = step.toughness / intensity  # load factor at which K_I = K_Ic (Irwin 1957)
    if critical >= 1:
        return np.inf, opening, drive
    load = max(min(step.came / ramp.rise, 1.0), critical * 1.02)
    # Freund 1990: v = c_R (1 - G_c / G); at least a tenth, so that a barely critical front still moves
    velocity = ramp.speed * max(1 - (critical / load) ** 2, 0.1)
    return max(step.came, critical * ramp.rise) + step.length / velocity, opening, drive


@njit(cache=True)
def _seeded(seed, start):
    """The initial heap of a march: the voxels around the seed."""
    heap = [(start, int(seed[0]), int(seed[1]), int(seed[2]))]
    for i in range(int(seed[0]) - 2, int(seed[0]) + 4):
        for j in range(int(seed[1]) - 2, int(seed[1]) + 4):
            for k in range(int(seed[2]) - 2, int(seed[2]) + 4):
                heapq.heappush(heap, (start, i, j, k))
    return heap


@njit(cache=True)
def _distance_and_normal(level_set, x, y, z, ratio, h):
    """Signed distance to the crack surface [m] and its normal at a fractional coarse index; infinite where the
    potential is too flat."""
    p, gx, gy, gz = _value_and_gradient(level_set, x, y, z, 0.6 * ratio)
    slope = np.sqrt(gx * gx + gy * gy + gz * gz) + 1e-12
    offset = p / slope * h / ratio if slope * ratio / h >= 0.1 else np.inf  # gradient per coarse index
    return offset, gx / slope, gy / slope, gz / slope


@njit(cache=True)
def _offer(heap, state, time, i, j, k):
    """Push the neighbours of a voxel that the front can reach across uncut faces."""
    for axis in range(3):
        a, b, c = i + (axis == 0), j + (axis == 1), k + (axis == 2)
        if state.status[a, b, c] == 0 and not state.cut[i, j, k] & (1 << axis):
            heapq.heappush(heap, (time, a, b, c))
        a, b, c = i - (axis == 0), j - (axis == 1), k - (axis == 2)
        if state.status[a, b, c] == 0 and not state.cut[a, b, c] & (1 << axis):
            heapq.heappush(heap, (time, a, b, c))


@njit(cache=True)
def march(fields, state, ramp, seed, start, h, ratio):
    """Fast marching of the front from `seed` (fractional fine index) at time `start` [s].

    h: spacing of the fine grid [m]; ratio: fine over coarse spacing.
    Returns accepted voxels (n, 3), and for each the distance to the crack surface and its normal (n, 4)."""
    n = fields.sdf.shape[0]
    voxels = [(0, 0, 0) for _ in range(0)]
    surface = [(0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    heap = _seeded(seed, start)
    while len(heap) > 0:
        now, i, j, k = heapq.heappop(heap)
        if min(i, j, k) < 2 or max(i, j, k) > n - 3 or state.status[i, j, k] != 0:
            continue
        depth = fields.sdf[i, j, k]
        if depth < -OVERSHOOT * h:
            continue
        x, y, z = (i + 0.5) * ratio - 0.5, (j + 0.5) * ratio - 0.5, (k + 0.5) * ratio - 0.5
        offset, nx, ny, nz = _distance_and_normal(fields.level_set, x, y, z, ratio, h)
        if abs(offset) > BAND * h:
            continue
        radius = np.sqrt((i - seed[0]) ** 2 + (j - seed[1]) ** 2 + (k - seed[2]) ** 2)
        tension = _opening_stress(fields.stress, x, y, z, nx, ny, nz)
        reached, opening, drive = start, max(tension, 0.0), max(tension, 0.0)
        if radius > NUCLEUS:
            came, di, dj, dk = _parent(state.status, state.arrival, i, j, k)
            if came == np.inf:
                continue
            a, b, c = i + di, j + dj, k + dk
            step = _Step(
                came, state.mouth[a, b, c], state.drive[a, b, c], np.sqrt(float(di * di + dj * dj + dk * dk)) * h,
                tension, interpolate(fields.thickness, x, y, z), radius * h, depth,
                interpolate(fields.toughness, x, y, z),
            )  # fmt: skip
            reached, opening, drive = _advance(step, ramp)
            if reached == np.inf:
                continue
            if reached > now * (1 + 1e-6) + 1e-12:  # not due yet: other voxels come first
                heapq.heappush(heap, (reached, i, j, k))
                continue
        state.arrival[i, j, k], state.mouth[i, j, k], state.drive[i, j, k] = reached, opening, drive
        stopped = radius > NUCLEUS and depth < -h
        state.status[i, j, k] = STOPPED if stopped else FRONT
        voxels.append((i, j, k))
        surface.append((offset, nx, ny, nz))
        if not stopped:
            _offer(heap, state, reached, i, j, k)
    return voxels, surface


def grow(
    state: MarchState,
    fields: MarchFields,
    ramp: LoadRamp,
    *,
    seed: Floats,
    start: float,
    fine: PaddedGrid,
    coarse: PaddedGrid,
) -> Crack:
    """Grow one crack from `seed` [m] at time `start` [s]; cuts no faces yet."""
    index = (seed - fine.first_centre) / fine.spacing
    accepted, surface = march(fields, state, ramp, index, start, fine.spacing, fine.spacing / coarse.spacing)
    voxels = np.array(accepted, np.int64).reshape(-1, 3)
    values = np.array(surface, float).reshape(-1, 4)
    arrival = state.arrival[tuple(voxels.T)].astype(float)
    return Crack(voxels, np.ascontiguousarray(values[:, 0]), np.ascontiguousarray(values[:, 1:]), arrival)
