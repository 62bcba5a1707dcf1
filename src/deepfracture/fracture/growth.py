"""One crack: its front marches over a sheet while the load rises, wherever it can pay for new surface."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.fracture.lattice import Lattice, interpolate
from deepfracture.types import Floats, Floats32, Ints

BAND = 1.5
"""Voxels whose centre lies within this many spacings of the sheet take part in the march."""
OVERSHOOT = 1.8
"""A front runs this many voxels past the surface, so that no voxel inside is left uncut."""
FREE_SURFACE_LIMIT = 2.5
"""Upper bound of the free-surface factor of the stress intensity (fitted for a/R up to 0.7, where it is 1.5)."""
NUCLEUS = 2.0
"""Radius within which a crack opens at once [voxels]: below it a front has no meaning on the lattice."""
FRONT, STOPPED = 1, 2


@dataclass(frozen=True, eq=False)
class Crack:
    """What one crack opened."""

    voxels: Ints
    """Fine-lattice cells that the front passed, shape (n, 3)."""
    offset: Floats
    """Signed distance from the cell's centre to the sheet [m], shape (n,)."""
    normals: Floats
    """Unit normal of the sheet, shape (n, 3)."""
    arrival: Floats
    """When the front came by [s since first contact], shape (n,)."""


@dataclass(frozen=True, eq=False)
class Front:
    """The scratch fields of a march over the fine lattice; all zero between cracks but for `cut`."""

    status: np.ndarray
    arrival: Floats32
    mouth: Floats32
    """Tension that opens the wall here [Pa]."""
    drive: Floats32
    """Its mean along the path of the front [Pa]."""
    cut: np.ndarray
    """Faces that cracks have opened, a bit for each axis (towards the next cell): a front stops there, in a
    T-junction."""

    @staticmethod
    def on(lattice: Lattice) -> Front:
        arrival, mouth, drive = (np.zeros(lattice.shape, np.float32) for _ in range(3))
        return Front(np.zeros(lattice.shape, np.uint8), arrival, mouth, drive, np.zeros(lattice.shape, np.uint8))

    def clear(self, crack: Crack) -> None:
        """Forget the march of `crack`."""
        cells = tuple(crack.voxels.T)
        for scratch in (self.status, self.arrival, self.mouth, self.drive):
            scratch[cells] = 0


@dataclass(frozen=True)
class Ramp:
    """The load grows linearly to its peak; a crack runs at most at the speed of Rayleigh waves."""

    rise: float
    """Time from first contact to peak load [s]."""
    speed: float
    """[m/s]"""
    longest: float
    """Crack length beyond which stress intensity no longer grows: the size of the body [m]."""


@njit(cache=True)
def _sheet_at(sheet, x, y, z, step):
    """Offset and gradient of the sheet's potential at a fractional coarse index (gradient per index)."""
    p = interpolate(sheet, x, y, z)
    gx = (interpolate(sheet, x + step, y, z) - interpolate(sheet, x - step, y, z)) / (2 * step)
    gy = (interpolate(sheet, x, y + step, z) - interpolate(sheet, x, y - step, z)) / (2 * step)
    gz = (interpolate(sheet, x, y, z + step) - interpolate(sheet, x, y, z - step)) / (2 * step)
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
    """The neighbour from which the front comes first: its arrival time, index offset and distance in cells."""
    best, bi, bj, bk = np.inf, 0, 0, 0
    for di in range(-1, 2):
        for dj in range(-1, 2):
            for dk in range(-1, 2):
                if status[i + di, j + dj, k + dk] == FRONT and arrival[i + di, j + dj, k + dk] < best:
                    best, bi, bj, bk = arrival[i + di, j + dj, k + dk], di, dj, dk
    return best, bi, bj, bk


@njit(cache=True)
def _advance(came, before, past, step, local, thickness, a, depth, toughness, rise, speed, longest):
    """The front goes on by one cell: arrival time (inf: never), tension that opens the wall, its mean so far.

    came, before, past: arrival, opening tension and its mean at the cell that the front comes from; step: the
    distance from there [m]; local: tension across the sheet [Pa]; a: crack length [m]; depth: to the surface [m]."""
    # The tension at a crack's mouth drives it through the wall although the far side is compressed:
    # under bending K_I of an edge crack never falls below that of the surface stress (Tada 2.13).
    opening = max(local, before * np.exp(-step / thickness))
    # Along the wall K_I weighs the tension over the whole crack, not at its front alone (Tada 5.11).
    pull = past + (opening - past) * min(step / a, 1.0)
    if pull <= 0:
        return np.inf, opening, pull
    near = a / (a + max(depth, 0.0))
    surface = min(1 / (1 - min(near * near * near, 0.9)), FREE_SURFACE_LIMIT)
    # Sneddon 1946: penny crack, K_I = 2 sigma sqrt(a / pi); then the free-surface factor
    intensity = 2 * pull * np.sqrt(min(a, longest) / np.pi) * surface
    need = toughness / intensity  # share of the peak load that moves the front
    if need >= 1:
        return np.inf, opening, pull
    load = max(min(came / rise, 1.0), need * 1.02)
    # Freund 1990: v = c_R (1 - G_c / G); at least a tenth, so that a barely critical front still moves
    velocity = speed * max(1 - (need / load) ** 2, 0.1)
    return max(came, need * rise) + step / velocity, opening, pull


@njit(cache=True)
def _seeded(seed, start):
    """The heap of a march: the cells around the seed."""
    heap = [(start, int(seed[0]), int(seed[1]), int(seed[2]))]
    for i in range(int(seed[0]) - 2, int(seed[0]) + 4):
        for j in range(int(seed[1]) - 2, int(seed[1]) + 4):
            for k in range(int(seed[2]) - 2, int(seed[2]) + 4):
                heapq.heappush(heap, (start, i, j, k))
    return heap


@njit(cache=True)
def _on_sheet(sheet, x, y, z, ratio, h):
    """Signed distance to the sheet [m] and its normal at a fractional coarse index; infinite where it is too flat."""
    p, gx, gy, gz = _sheet_at(sheet, x, y, z, 0.6 * ratio)
    slope = np.sqrt(gx * gx + gy * gy + gz * gz) + 1e-12
    offset = p / slope * h / ratio if slope * ratio / h >= 0.1 else np.inf  # gradient per coarse index
    return offset, gx / slope, gy / slope, gz / slope


@njit(cache=True)
def march(
    sdf, wall, stress, sheet, toughness, status, arrival, mouth, drive, cut,
    seed, start, h, ratio, rise, speed, longest,
):  # fmt: skip
    """Fast marching (a heap of arrival times) of the front from `seed` (fractional fine index).

    sdf: distance to the surface on the fine lattice [m]. On the coarse lattice: wall, the local thickness [m],
    stress (6, m, m, m) [Pa], sheet [m], toughness [Pa sqrt(m)], each (m, m, m).
    Returns accepted cells (n, 3), and for each the distance to the sheet and its normal (n, 4)."""
    n = sdf.shape[0]
    cells = [(0, 0, 0) for _ in range(0)]
    found = [(0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    heap = _seeded(seed, start)
    while len(heap) > 0:
        now, i, j, k = heapq.heappop(heap)
        if min(i, j, k) < 2 or max(i, j, k) > n - 3 or status[i, j, k] != 0 or sdf[i, j, k] < -OVERSHOOT * h:
            continue
        x, y, z = (i + 0.5) * ratio - 0.5, (j + 0.5) * ratio - 0.5, (k + 0.5) * ratio - 0.5
        offset, nx, ny, nz = _on_sheet(sheet, x, y, z, ratio, h)
        if abs(offset) > BAND * h:
            continue
        radius = np.sqrt((i - seed[0]) ** 2 + (j - seed[1]) ** 2 + (k - seed[2]) ** 2)
        local = _opening_stress(stress, x, y, z, nx, ny, nz)
        reached, opening, pull = start, max(local, 0.0), max(local, 0.0)
        if radius > NUCLEUS:
            came, di, dj, dk = _parent(status, arrival, i, j, k)
            if came == np.inf:
                continue
            a, b, c = i + di, j + dj, k + dk
            reached, opening, pull = _advance(
                came, mouth[a, b, c], drive[a, b, c], np.sqrt(float(di * di + dj * dj + dk * dk)) * h, local,
                interpolate(wall, x, y, z), radius * h, sdf[i, j, k], interpolate(toughness, x, y, z),
                rise, speed, longest,
            )  # fmt: skip
            if reached == np.inf:
                continue
            if reached > now * (1 + 1e-6) + 1e-12:
                heapq.heappush(heap, (reached, i, j, k))
                continue
        arrival[i, j, k], mouth[i, j, k], drive[i, j, k] = reached, opening, pull
        stopped = radius > NUCLEUS and sdf[i, j, k] < -h
        status[i, j, k] = STOPPED if stopped else FRONT
        cells.append((i, j, k))
        found.append((offset, nx, ny, nz))
        for axis in range(0 if stopped else 3):
            a, b, c = i + (axis == 0), j + (axis == 1), k + (axis == 2)
            if status[a, b, c] == 0 and not cut[i, j, k] & (1 << axis):
                heapq.heappush(heap, (reached, a, b, c))
            a, b, c = i - (axis == 0), j - (axis == 1), k - (axis == 2)
            if status[a, b, c] == 0 and not cut[a, b, c] & (1 << axis):
                heapq.heappush(heap, (reached, a, b, c))
    return cells, found


def grow(
    front: Front,
    sdf: Floats32,
    wall: Floats32,
    stress: Floats32,
    sheet: Floats32,
    toughness: Floats32,
    *,
    seed: Floats,
    start: float,
    fine: Lattice,
    coarse: Lattice,
    ramp: Ramp,
) -> Crack:
    """Grow one crack from `seed` [m] at time `start` [s]; marks nothing as broken."""  # fmt: skip
    index = (seed - fine.first_centre) / fine.spacing
    cells, found = march(
        sdf, wall, stress, sheet, toughness, front.status, front.arrival, front.mouth, front.drive, front.cut,
        index, start, fine.spacing, fine.spacing / coarse.spacing, ramp.rise, ramp.speed, ramp.longest,
    )  # fmt: skip
    voxels = np.array(cells, np.int64).reshape(-1, 3)
    values = np.array(found, float).reshape(-1, 4)
    arrival = front.arrival[tuple(voxels.T)].astype(float)
    return Crack(voxels, values[:, 0], values[:, 1:], arrival)
