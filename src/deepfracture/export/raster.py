"""Draws triangles in plain compiled loops: it needs no graphics driver and no system library,
and the same scene gives the same picture on every machine.

A depth buffer decides what each sample sees; two more, from the key light and from straight above,
give soft shadows and the open sky that ambient light comes from.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..types import Floats32

NOTHING = -1
"""What a sample sees that no triangle covers: the floor or the backdrop."""
BANDS = 16
"""Strips of rows drawn side by side: no two threads write one pixel."""
F = np.float32
ZERO, ONE = F(0), F(1)
FAR = F(1e30)
"""Farther than anything: the compiled loops assume that nothing is infinite."""
RING = 5
"""First taps of a shadow, near the rim of its disc: when they agree, no edge is near."""


class Bodies(NamedTuple):
    """What stands in the picture."""

    faces: NDArray[np.int32]
    """Vertices of each triangle, shape (m, 3)."""
    patch: NDArray[np.int32]
    """Triangles of one smooth surface share a number, shape (m,)."""
    colour: Floats32
    """Linear light, shape (m, 3)."""
    gloss: Floats32
    """0 dull .. 1 polished, shape (m,)."""
    normals: Floats32
    """Unit normals of the vertices in the world, shape (n, 3)."""
    sky: Floats32
    """Share of the sky that each vertex sees, shape (n,)."""


class View(NamedTuple):
    """A perspective camera, float32 arrays."""

    position: Floats32
    axes: Floats32
    """Rows right, up, back, shape (3, 3)."""
    focal: float
    """Samples across one unit at distance one."""
    floor: float
    """Height of the floor, -FAR without one."""
    fade: float
    """Distance from the lights' centre at which the floor has become the backdrop."""
    floor_colour: Floats32
    back_colour: Floats32


class Lights(NamedTuple):
    """Key, sky and fill light."""

    centre: Floats32
    """Middle of the region that casts shadows, shape (3,)."""
    radius: float
    """Half its side [m]."""
    key_axes: Floats32
    """Rows right, up, towards the light, shape (3, 3)."""
    key_depth: Floats32
    """Depth buffer of the key light, shape (t, t)."""
    floor_sky: Floats32
    """Share of the sky that the floor sees, over the region, shape (g, g)."""
    fill: Floats32
    """Towards the fill light, shape (3,)."""
    soft: float
    """Radius of the key shadow's edge [m]."""
    taps: Floats32
    """Points of the unit disc, shape (k, 2), the first RING of them near its rim."""


def taps(count: int = 16) -> Floats32:
    """Vogel 1979: a sunflower's spiral fills a disc evenly."""
    k = np.arange(count)
    radius = np.where(k < RING, 0.95 - 0.05 * k, np.sqrt(np.maximum(k - RING + 0.5, 0) / (count - RING)))
    angle = np.where(k < RING, 2 * np.pi * k / RING, np.pi * (3 - np.sqrt(5)) * k)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).astype(F)


def linear(colour: tuple[int, int, int]) -> Floats32:
    """Linear light of an sRGB colour 0..255, shape (3,)."""
    value = np.array(colour) / 255
    # IEC 61966-2-1
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(F)


def encoding() -> NDArray[np.uint8]:
    """sRGB byte of linear light 0..1 in 4096 steps."""
    value = np.arange(4096) / 4095
    code = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.round(255 * code).astype(np.uint8)


def see(
    vertices: Floats32, faces: NDArray[np.int32], axes: Floats32, origin: Floats32, scale: float, size: tuple[int, int]
) -> tuple[Floats32, Floats32, NDArray[np.int32]]:
    """Project in perspective and draw: screen x, y and 1/distance (n, 3); depth (h, w); triangle (h, w)."""
    screen = _projected(vertices, axes, origin, scale, size)
    inverse = np.divide(-1, screen[:, 2:], out=np.full_like(screen[:, 2:], np.nan), where=screen[:, 2:] < -1e-3)
    screen[:, :2] *= inverse
    screen[:, 2:] = inverse
    return (screen, *_drawn(screen, faces, size, 0.0))


def see_parallel(
    vertices: Floats32, faces: NDArray[np.int32], axes: Floats32, origin: Floats32, scale: float, size: tuple[int, int]
) -> Floats32:
    """Depth buffer (h, w) of a parallel projection [m towards the viewer], -inf where nothing is."""
    screen = _projected(vertices, axes, origin, scale, size)
    return _drawn(screen, faces, size, -np.inf)[0]


def _projected(
    vertices: Floats32, axes: Floats32, origin: Floats32, scale: float, size: tuple[int, int]
) -> Floats32:
    """Right and down [sample] from the middle of the picture, and depth towards the viewer [m]."""
    return (vertices - origin) @ (axes * F([[scale], [-scale], [1]])).T


def _drawn(
    screen: Floats32, faces: NDArray[np.int32], size: tuple[int, int], nothing: float
) -> tuple[Floats32, NDArray[np.int32]]:
    width, height = size
    screen[:, 0] += F(width / 2)
    screen[:, 1] += F(height / 2)
    depth = np.full((height, width), nothing, F)
    triangle = np.full((height, width), NOTHING, np.int32)
    _draw(screen, faces, depth, triangle)
    return depth, triangle


@njit(cache=True, parallel=True)
def _draw(screen, faces, depth, triangle):
    for band in prange(BANDS):
        _draw_rows(screen, faces, band * len(depth) // BANDS, (band + 1) * len(depth) // BANDS, depth, triangle)


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _draw_rows(screen, faces, low, high, depth, triangle):
    """Rows low..high-1 of the nearest triangles; faces with a corner behind the camera (NaN) are left out."""
    width = depth.shape[1]
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ya, yb, yc = screen[a, 1], screen[b, 1], screen[c, 1]
        top, bottom = min(ya, min(yb, yc)), max(ya, max(yb, yc))
        if bottom < low or top > high:
            continue
        xa, xb, xc = screen[a, 0], screen[b, 0], screen[c, 0]
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if not abs(area) > 1e-9:
            continue
        za, over = screen[a, 2], F(1) / area
        dzb, dzc = (screen[b, 2] - za) * over, (screen[c, 2] - za) * over
        left = max(0, int(np.ceil(min(xa, min(xb, xc)) - 0.5)))
        right = min(width - 1, int(np.floor(max(xa, max(xb, xc)) - 0.5)))
        for j in range(max(low, int(np.ceil(top - 0.5))), min(high - 1, int(np.floor(bottom - 0.5))) + 1):
            y = F(j + 0.5) - ya
            for i in range(left, right + 1):
                x = F(i + 0.5) - xa
                v = x * (yc - ya) - (xc - xa) * y
                w = (xb - xa) * y - x * (yb - ya)
                if v * over >= 0 and w * over >= 0 and (v + w) * over <= 1:
                    z = za + v * dzb + w * dzc
                    if z > depth[j, i]:
                        depth[j, i], triangle[j, i] = z, f


@njit(cache=True, fastmath=True)
def _open(depth, table, x, y, z, radius, cosine, sine):
    """Share of the disc of `radius` around texel (x, y) in which nothing is nearer to the light than z."""
    height, width = depth.shape
    free = 0
    for k in range(len(table)):
        if k == RING and (free == 0 or free == RING):
            return F(free / RING)
        i = int(x + radius * (cosine * table[k, 0] - sine * table[k, 1]))
        j = int(y + radius * (sine * table[k, 0] + cosine * table[k, 1]))
        if i < 0 or j < 0 or i >= width or j >= height or depth[j, i] <= z:
            free += 1
    return F(free / len(table))


@njit(cache=True, fastmath=True)
def _key_light(lights, px, py, pz, nx, ny, nz, turn):
    """Key light on a point, 0..1."""
    key, centre, size = lights.key_axes, lights.centre, F(lights.key_depth.shape[0])
    facing = nx * key[2, 0] + ny * key[2, 1] + nz * key[2, 2]
    if facing <= ZERO:
        return ZERO
    scale = size / (F(2) * lights.radius)
    lift = F(2) / scale  # off its surface by two texels, so that it does not shade itself
    qx, qy, qz = px + nx * lift - centre[0], py + ny * lift - centre[1], pz + nz * lift - centre[2]
    x = size / F(2) + scale * (key[0, 0] * qx + key[0, 1] * qy + key[0, 2] * qz)
    y = size / F(2) - scale * (key[1, 0] * qx + key[1, 1] * qy + key[1, 2] * qz)
    z = key[2, 0] * qx + key[2, 1] * qy + key[2, 2] * qz + lift
    return facing * _open(lights.key_depth, lights.taps, x, y, z, lights.soft * scale, np.cos(turn), np.sin(turn))


@njit(cache=True, parallel=True, fastmath=True)
def sky_seen(points, normals, depth, centre, radius, reaches, table):
    """Share of the sky (n,) that points (n, 3) see past what `depth`, the view from above, shows nearby.

    reaches: radii of the discs [m] over which it looks."""
    seen = np.empty(len(points), np.float32)
    size = F(depth.shape[0])
    scale = size / (F(2) * radius)
    lift = F(2) / scale
    for i in prange(len(points)):
        x = size / F(2) + scale * (points[i, 0] + normals[i, 0] * lift - centre[0])
        y = size / F(2) - scale * (points[i, 1] + normals[i, 1] * lift - centre[1])
        z = points[i, 2] + (normals[i, 2] + ONE) * lift - centre[2]
        free = 0
        for reach in reaches:
            for k in range(len(table)):
                a, b = int(x + reach * scale * table[k, 0]), int(y + reach * scale * table[k, 1])
                if a < 0 or b < 0 or a >= depth.shape[1] or b >= depth.shape[0] or depth[b, a] <= z:
                    free += 1
        seen[i] = F(free) / F(len(table) * len(reaches))
    return seen


@njit(cache=True, fastmath=True)
def _floor_sky(lights, px, py):
    """Bilinear look-up of `floor_sky`, 1 beyond the region."""
    table, count = lights.floor_sky, lights.floor_sky.shape[0]
    scale = F(count - 1) / (F(2) * lights.radius)
    x, y = (px - lights.centre[0] + lights.radius) * scale, (py - lights.centre[1] + lights.radius) * scale
    i, j = int(np.floor(x)), int(np.floor(y))
    if i < 0 or j < 0 or i >= count - 1 or j >= count - 1:
        return ONE
    x, y = x - F(i), y - F(j)
    low = table[j, i] + (table[j, i + 1] - table[j, i]) * x
    high = table[j + 1, i] + (table[j + 1, i + 1] - table[j + 1, i]) * x
    return low + (high - low) * y


@njit(cache=True, fastmath=True)
def _reflected(view, lights, p, n, toward, base, shine, sky, ground, turn):
    """Linear light, three channels, that leaves a point towards the camera."""
    nx, ny, nz = n
    back, mist = view.back_colour, ZERO
    if ground:
        far = np.sqrt((p[0] - lights.centre[0]) ** 2 + (p[1] - lights.centre[1]) ** 2) / view.fade
        mist = min(max((far - F(0.35)) / F(0.65), ZERO), ONE)
        mist *= mist * (F(3) - F(2) * mist)
        if mist > F(0.995):
            return back[0], back[1], back[2]
    key = _key_light(lights, p[0], p[1], p[2], nx, ny, nz, turn)
    filled = max(ZERO, nx * lights.fill[0] + ny * lights.fill[1] + nz * lights.fill[2])
    ambient = F(0.26) * (ONE + nz) * (F(0.25) + F(0.75) * sky) + F(0.16) * filled + F(0.175) * (ONE - nz)
    spark = ZERO
    if shine > ZERO:
        away = ONE / np.sqrt(toward[0] ** 2 + toward[1] ** 2 + toward[2] ** 2)
        ex, ey, ez = -toward[0] * away, -toward[1] * away, -toward[2] * away
        hx, hy, hz = ex + lights.key_axes[2, 0], ey + lights.key_axes[2, 1], ez + lights.key_axes[2, 2]
        along = max(ZERO, nx * hx + ny * hy + nz * hz) / np.sqrt(hx * hx + hy * hy + hz * hz)
        edge = ONE - min(max(nx * ex + ny * ey + nz * ez, ZERO), ONE)
        # Blinn 1977, and a faint rim
        spark = shine * (F(0.5) * key * along**40 + F(0.12) * edge**4 * (F(0.3) + F(0.7) * sky))
    # the key light is warm, the sky cool
    red = base[0] * (F(0.80) * key + F(0.96) * ambient) + spark
    green = base[1] * (F(0.76) * key + F(1.00) * ambient) + spark
    blue = base[2] * (F(0.72) * key + F(1.04) * ambient) + spark
    return red + (back[0] - red) * mist, green + (back[1] - green) * mist, blue + (back[2] - blue) * mist


@njit(cache=True, fastmath=True)
def _sample(x, y, middle, f, screen, bodies, view, lights):
    """Linear light of one sample at (x, y) that sees triangle f."""
    sx, sy = (x - middle[0]) / view.focal, (middle[1] - y) / view.focal
    axes, eye = view.axes, view.position
    toward = (
        axes[0, 0] * sx + axes[1, 0] * sy - axes[2, 0],
        axes[0, 1] * sx + axes[1, 1] * sy - axes[2, 1],
        axes[0, 2] * sx + axes[1, 2] * sy - axes[2, 2],
    )
    turn = F(6.2832) * ((F(0.7548777) * x + F(0.5698403) * y) % F(1))
    reach = (view.floor - eye[2]) / toward[2] if toward[2] < F(-1e-6) else FAR
    if f != NOTHING:
        faces, normals, colour = bodies.faces, bodies.normals, bodies.colour
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        xb, yb = screen[b, 0] - screen[a, 0], screen[b, 1] - screen[a, 1]
        xc, yc = screen[c, 0] - screen[a, 0], screen[c, 1] - screen[a, 1]
        x, y, over = x - screen[a, 0], y - screen[a, 1], ONE / (xb * yc - xc * yb)
        v, w = (x * yc - xc * y) * over, (xb * y - x * yb) * over
        # weights over distance: linear in space, not on the screen (Blinn 1992)
        u, v, w = (ONE - v - w) * screen[a, 2], v * screen[b, 2], w * screen[c, 2]
        away = ONE / (u + v + w)
        if away < reach:
            u, v, w = u * away, v * away, w * away
            nx = u * normals[a, 0] + v * normals[b, 0] + w * normals[c, 0]
            ny = u * normals[a, 1] + v * normals[b, 1] + w * normals[c, 1]
            nz = u * normals[a, 2] + v * normals[b, 2] + w * normals[c, 2]
            sky = u * bodies.sky[a] + v * bodies.sky[b] + w * bodies.sky[c]
            unit = ONE / np.sqrt(nx * nx + ny * ny + nz * nz + F(1e-20))
            p = (eye[0] + toward[0] * away, eye[1] + toward[1] * away, eye[2] + toward[2] * away)
            n = (nx * unit, ny * unit, nz * unit)
            base = (colour[f, 0], colour[f, 1], colour[f, 2])
            return _reflected(view, lights, p, n, toward, base, bodies.gloss[f], sky, False, turn)
    if reach < F(1e6):
        p = (eye[0] + toward[0] * reach, eye[1] + toward[1] * reach, eye[2] + toward[2] * reach)
        n = (ZERO, ZERO, ONE)
        base = (view.floor_colour[0], view.floor_colour[1], view.floor_colour[2])
        return _reflected(view, lights, p, n, toward, base, ZERO, _floor_sky(lights, p[0], p[1]), True, turn)
    back = view.back_colour
    return back[0], back[1], back[2]


@njit(cache=True, fastmath=True)
def _alike(depth, triangle, patch, top, left, samples):
    """Whether all samples of a pixel see one smooth patch without a fold: then one of them speaks for all."""
    f, nearest, farthest = triangle[top, left], ZERO, FAR
    for j in range(top, top + samples):
        for i in range(left, left + samples):
            g = triangle[j, i]
            if g != f and (g == NOTHING or f == NOTHING or patch[g] != patch[f]):
                return False
            nearest, farthest = max(nearest, depth[j, i]), min(farthest, depth[j, i])
    return nearest <= farthest * F(1.02)


@njit(cache=True, fastmath=True)
def _shade_row(j, samples, depth, triangle, screen, bodies, view, lights, encode, out):
    middle, step = (F(triangle.shape[1]) / F(2), F(triangle.shape[0]) / F(2)), samples // 2
    for i in range(out.shape[1]):
        red, green, blue = ZERO, ZERO, ZERO
        count = samples * samples
        if _alike(depth, triangle, bodies.patch, j * samples, i * samples, samples):
            count = 1
        for k in range(count):
            y, x = (k // samples, k % samples) if count > 1 else (step, step)
            x, y = i * samples + x, j * samples + y
            f = triangle[y, x]
            r, g, b = _sample(F(x) + F(0.5), F(y) + F(0.5), middle, f, screen, bodies, view, lights)
            red += min(r, ONE)
            green += min(g, ONE)
            blue += min(b, ONE)
        share = F(len(encode) - 1) / F(count)
        out[j, i, 0] = encode[int(max(red, ZERO) * share)]
        out[j, i, 1] = encode[int(max(green, ZERO) * share)]
        out[j, i, 2] = encode[int(max(blue, ZERO) * share)]


@njit(cache=True, parallel=True)
def shade(samples, depth, triangle, screen, bodies, view, lights, encode, out):
    """sRGB picture `out` (h, w, 3) of what `see` saw, samples x samples a pixel; `encode` = `encoding()`."""
    for j in prange(len(out)):
        _shade_row(j, samples, depth, triangle, screen, bodies, view, lights, encode, out)
