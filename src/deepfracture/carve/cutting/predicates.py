"""Orientation of four points: filtered floats, then double-double (Shewchuk 1997; Dekker 1971)."""

from __future__ import annotations

from numba import njit

ROUNDING = 2.0**-53
BOUND = (7 + 56 * ROUNDING) * ROUNDING
"""Relative error of the determinant in floats (Shewchuk 1997, orient3d, stage A)."""
FINE_BOUND = 2.0**-98
"""The same in double-double, with room to spare."""
SPLITTER = 2.0**27 + 1


@njit(cache=True)
def orient3d(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz):
    """Sign of (b - a) x (c - a) . (d - a): 1 if d lies above the plane through a, b, c, which turn to the left seen
    from above; -1 below; 0 if the points are coplanar as far as double-double can tell."""
    ux, uy, uz, vx, vy, vz, wx, wy, wz = ax - dx, ay - dy, az - dz, bx - dx, by - dy, bz - dz, cx - dx, cy - dy, cz - dz
    vw, wv, wu, uw, uv, vu = vx * wy, wx * vy, wx * uy, ux * wy, ux * vy, vx * uy
    determinant = uz * (vw - wv) + vz * (wu - uw) + wz * (uv - vu)
    size = (abs(vw) + abs(wv)) * abs(uz) + (abs(wu) + abs(uw)) * abs(vz) + (abs(uv) + abs(vu)) * abs(wz)
    if abs(determinant) <= BOUND * size:
        determinant = _fine(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz)
        if abs(determinant) <= FINE_BOUND * size:
            return 0
    return -1 if determinant > 0 else 1


@njit(cache=True)
def orient3d_value(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz):
    """(b - a) x (c - a) . (d - a), accurate to the last digits of a float unless it all but vanishes."""
    return -_fine(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz)


@njit(cache=True)
def _fine(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz):
    """The determinant in double-double; differences are exact."""
    ux, uy, uz = _sum(ax, -dx), _sum(ay, -dy), _sum(az, -dz)
    vx, vy, vz = _sum(bx, -dx), _sum(by, -dy), _sum(bz, -dz)
    wx, wy, wz = _sum(cx, -dx), _sum(cy, -dy), _sum(cz, -dz)
    one = _times(_minus(_times(vx, wy), _times(wx, vy)), uz)
    two = _times(_minus(_times(wx, uy), _times(ux, wy)), vz)
    three = _times(_minus(_times(ux, vy), _times(vx, uy)), wz)
    total = _plus(_plus(one, two), three)
    return total[0] + total[1]


@njit(cache=True, inline="always")
def _sum(a, b):
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@njit(cache=True, inline="always")
def _product(a, b):
    total = a * b
    c = SPLITTER * a
    a_high = c - (c - a)
    a_low = a - a_high
    c = SPLITTER * b
    b_high = c - (c - b)
    b_low = b - b_high
    return total, ((a_high * b_high - total) + a_high * b_low + a_low * b_high) + a_low * b_low


@njit(cache=True, inline="always")
def _plus(a, b):
    high, low = _sum(a[0], b[0])
    other, rest = _sum(a[1], b[1])
    high, low = _sum(high, low + other)
    return _sum(high, low + rest)


@njit(cache=True, inline="always")
def _minus(a, b):
    return _plus(a, (-b[0], -b[1]))


@njit(cache=True, inline="always")
def _times(a, b):
    high, low = _product(a[0], b[0])
    return _sum(high, low + (a[0] * b[1] + a[1] * b[0]))
