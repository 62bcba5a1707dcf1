"""A software rasteriser in compiled loops: no graphics driver, no system library, and the same scene gives the same
picture on every machine.

A depth buffer decides what each sample shows; two shadow maps, from the key light and from straight above, give soft
shadows and ambient occlusion. The loops release the GIL, so threads draw several pictures at once.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from deepfracture.types import Floats32

Triple = tuple[np.float32, np.float32, np.float32]

NOTHING = -1
"""A sample that no triangle covers: it shows the floor or the backdrop."""
OPTIONS = {"cache": True, "nogil": True, "fastmath": True, "_nrt": False}
"""No loop allocates, so Numba need not count references to arrays: threads that share arrays would wait for each other
at the counters, which makes shading three times slower."""
compiled = partial(njit, **OPTIONS)
F = np.float32
ZERO, ONE = F(0), F(1)
FAR = F(1e30)
"""Farther than anything: the compiled loops assume that nothing is infinite."""
RING = 0.3
"""Share of a shadow's taps that come first, near the rim of its disc: when they agree, no edge is near."""


class View(NamedTuple):
    """A perspective camera. Plain numbers: compiled loops copy them faster than arrays."""

    eye: Triple
    right: Triple
    up: Triple
    back: Triple
    focal: np.float32
    """Samples across one unit at distance one."""
    floor: np.float32
    """Height of the floor, -FAR without one."""
    fade: np.float32
    """Distance from the lights' centre at which the floor has become the backdrop."""
    floor_colour: Triple
    backdrop: Triple


class Lights(NamedTuple):
    """Key and fill light, and the region in which bodies cast shadows."""

    centre: Triple
    radius: np.float32
    """Half the region's side [m]."""
    right: Triple
    up: Triple
    toward: Triple
    """Axes of the key light; `toward` leads to it."""
    fill: Triple
    """Towards the fill light."""
    soft: np.float32
    """Radius of the key shadow's edge [m]."""


class Shadows(NamedTuple):
    """Shadow maps."""

    key_depth: Floats32
    """Depth buffer of the key light, shape (t, t)."""
    floor_sky: Floats32
    """Share of the sky that the floor sees, over the region, shape (g, g)."""
    taps: Floats32
    """Points of the unit disc, shape (k, 2), the first share RING of them near its rim."""


class Bodies(NamedTuple):
    """What stands in the picture."""

    faces: NDArray[np.int32]
    """Vertices of each triangle, shape (m, 3)."""
    patch: NDArray[np.int32]
    """Triangles of one smooth surface share a number, shape (m,)."""
    looks: Floats32
    """Of each vertex: unit normal (3), linear colour (3), gloss 0..1, share of the sky seen, texture coordinates
    (2, v upward), shape (n, 10)."""
    page: NDArray[np.int32]
    """Row of `pages` that tints each triangle, -1 for none, shape (m,)."""
    pages: NDArray[np.int32]
    """Textures: first texel, width, height, shape (p, 3)."""
    texels: NDArray[np.uint8]
    """sRGB of all textures, row by row from the top, shape (t, 3)."""
    decode: Floats32
    """Linear light of an sRGB byte, shape (256,)."""


def triple(values: NDArray) -> Triple:
    x, y, z = np.asarray(values, np.float32)
    return x, y, z


def taps(count: int = 16) -> Floats32:
    """Vogel 1979: a sunflower's spiral fills a disc evenly."""
    k, ring = np.arange(count), int(RING * count)
    radius = np.where(k < ring, 0.95 - 0.2 * k / ring, np.sqrt(np.maximum(k - ring + 0.5, 0) / (count - ring)))
    angle = np.where(k < ring, 2 * np.pi * k / ring, np.pi * (3 - np.sqrt(5)) * k)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).astype(F)


def linear(colour: ArrayLike) -> Floats32:
    """Linear light of sRGB 0..255, the same shape."""
    value = np.asarray(colour) / 255
    # IEC 61966-2-1
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(F)


def encoding() -> NDArray[np.uint8]:
    """sRGB byte of linear light 0..1 in 4096 steps."""
    value = np.arange(4096) / 4095
    code = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.round(255 * code).astype(np.uint8)


def rasterize(
    vertices: Floats32,
    faces: NDArray[np.int32],
    axes: Floats32,
    origin: Floats32,
    scale: np.float32,
    size: tuple[int, int],
) -> tuple[Floats32, Floats32, NDArray[np.int32]]:
    """Project in perspective and draw: screen x, y and 1/distance (n, 3); depth (h, w); triangle (h, w)."""
    screen = _projected(vertices, axes, origin, scale, size)
    back = screen[:, 2:]
    inverse = np.divide(-1, back, out=np.full_like(back, np.nan), where=back < -1e-3)
    screen[:, :2] *= inverse
    screen[:, 2:] = inverse
    return (screen, *_drawn(screen, faces, size, 0.0))


def rasterize_parallel(
    vertices: Floats32,
    faces: NDArray[np.int32],
    axes: Floats32,
    origin: Floats32,
    scale: np.float32,
    size: tuple[int, int],
) -> Floats32:
    """Depth buffer (h, w) of a parallel projection [m towards the viewer], -inf where nothing is."""
    screen = _projected(vertices, axes, origin, scale, size)
    return _drawn(screen, faces, size, -np.inf)[0]


def _projected(
    vertices: Floats32, axes: Floats32, origin: Floats32, scale: np.float32, size: tuple[int, int]
) -> Floats32:
    """Right and down [sample] from the middle of the picture, and depth towards the viewer [m]."""
    return (vertices - origin) @ (axes * np.array([[scale], [-scale], [ONE]])).T


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


@compiled(fastmath={"contract", "reassoc", "arcp"})
def _draw(screen, faces, depth, triangle):
    """Nearest triangle of each sample; faces with a corner behind the camera (NaN) are left out."""
    height, width = depth.shape
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ya, yb, yc = screen[a, 1], screen[b, 1], screen[c, 1]
        top, bottom = min(ya, min(yb, yc)), max(ya, max(yb, yc))
        if not (bottom >= ZERO and top <= height):
            continue
        xa, xb, xc = screen[a, 0], screen[b, 0], screen[c, 0]
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if not abs(area) > 1e-9:
            continue
        za, over = screen[a, 2], F(1) / area
        dzb, dzc = (screen[b, 2] - za) * over, (screen[c, 2] - za) * over
        left = max(0, int(np.ceil(min(xa, min(xb, xc)) - 0.5)))
        right = min(width - 1, int(np.floor(max(xa, max(xb, xc)) - 0.5)))
        for j in range(max(0, int(np.ceil(top - 0.5))), min(height - 1, int(np.floor(bottom - 0.5))) + 1):
            y = F(j + 0.5) - ya
            for i in range(left, right + 1):
                x = F(i + 0.5) - xa
                v = x * (yc - ya) - (xc - xa) * y
                w = (xb - xa) * y - x * (yb - ya)
                if v * over >= 0 and w * over >= 0 and (v + w) * over <= 1:
                    z = za + v * dzb + w * dzc
                    if z > depth[j, i]:
                        depth[j, i], triangle[j, i] = z, f


@compiled()
def _open(depth, table, x, y, z, radius, cosine, sine):
    """Share of the disc of `radius` around texel (x, y) in which nothing is nearer to the light than z."""
    height, width = depth.shape
    free, ring = 0, int(RING * len(table))
    for k in range(len(table)):
        if k == ring and (free == 0 or free == ring):
            return F(free / ring)
        i = int(x + radius * (cosine * table[k, 0] - sine * table[k, 1]))
        j = int(y + radius * (sine * table[k, 0] + cosine * table[k, 1]))
        if i < 0 or j < 0 or i >= width or j >= height or depth[j, i] <= z:
            free += 1
    return F(free / len(table))


@compiled()
def sky_visibility(points, normals, depth, centre, radius, reaches, table, seen):
    """Share of the sky, into `seen` (n,), above points (n, 3) past what `depth`, the view from above, shows.

    reaches: radii of the discs [m] over which it looks."""
    size = F(depth.shape[0])
    scale = size / (F(2) * radius)
    lift = F(2) / scale
    for i in range(len(points)):
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


@compiled()
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled()
def _along(p, t, d):
    return p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]


@compiled()
def _key_light(shadows, lights, p, n, turn):
    """Key light on a point, 0..1."""
    facing = _dot(n, lights.toward)
    if facing <= ZERO:
        return ZERO
    size = F(shadows.key_depth.shape[0])
    scale = size / (F(2) * lights.radius)
    lift = F(2) / scale  # off its surface by two texels, so that it does not shade itself
    q = _along(_along(p, lift, n), F(-1), lights.centre)
    x, y = size / F(2) + scale * _dot(lights.right, q), size / F(2) - scale * _dot(lights.up, q)
    z, soft = _dot(lights.toward, q) + lift, lights.soft * scale
    return facing * _open(shadows.key_depth, shadows.taps, x, y, z, soft, np.cos(turn), np.sin(turn))


@compiled()
def _floor_sky(table, lights, p):
    """Bilinear look-up of `floor_sky`, 1 beyond the region."""
    count = table.shape[0]
    scale = F(count - 1) / (F(2) * lights.radius)
    x = (p[0] - lights.centre[0] + lights.radius) * scale
    y = (p[1] - lights.centre[1] + lights.radius) * scale
    i, j = int(np.floor(x)), int(np.floor(y))
    if i < 0 or j < 0 or i >= count - 1 or j >= count - 1:
        return ONE
    x, y = x - F(i), y - F(j)
    low = table[j, i] + (table[j, i + 1] - table[j, i]) * x
    high = table[j + 1, i] + (table[j + 1, i + 1] - table[j + 1, i]) * x
    return low + (high - low) * y


@compiled()
def _reflected(lights, n, toward, base, shine, key, sky):
    """Linear light, three channels, that leaves a point against `toward`, the ray that sees it."""
    ambient = F(0.26) * (ONE + n[2]) * (F(0.25) + F(0.75) * sky) + F(0.175) * (ONE - n[2])
    ambient += F(0.16) * max(ZERO, _dot(n, lights.fill))
    spark = ZERO
    if shine > ZERO:
        away = F(-1) / np.sqrt(_dot(toward, toward))
        eye = (toward[0] * away, toward[1] * away, toward[2] * away)
        half = _along(eye, ONE, lights.toward)
        along = max(ZERO, _dot(n, half)) / np.sqrt(_dot(half, half))
        edge = ONE - min(max(_dot(n, eye), ZERO), ONE)
        # Blinn 1977, and a faint rim
        spark = shine * (F(0.5) * key * along**40 + F(0.12) * edge**4 * (F(0.3) + F(0.7) * sky))
    # the key light is warm, the sky cool
    red = base[0] * (F(0.80) * key + F(0.96) * ambient) + spark
    green = base[1] * (F(0.76) * key + F(1.00) * ambient) + spark
    blue = base[2] * (F(0.72) * key + F(1.04) * ambient) + spark
    return red, green, blue


@compiled()
def _weights(x, y, a, b, c):
    """Shares of corners a, b, c (screen x, y, 1/distance) in what (x, y) sees, and how far that is."""
    xb, yb, xc, yc = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
    x, y, over = x - a[0], y - a[1], ONE / (xb * yc - xc * yb)
    v, w = (x * yc - xc * y) * over, (xb * y - x * yb) * over
    # weights over distance: linear in space, not on the screen (Blinn 1992)
    u, v, w = (ONE - v - w) * a[2], v * b[2], w * c[2]
    away = ONE / (u + v + w)
    return u * away, v * away, w * away, away


@compiled()
def _painted(bodies, page, u, v):
    """Linear colour of a texture that repeats, between its texels."""
    first, width, height = bodies.pages[page, 0], bodies.pages[page, 1], bodies.pages[page, 2]
    x, y = (u - np.floor(u)) * F(width) - F(0.5), (np.ceil(v) - v) * F(height) - F(0.5)
    i, j = int(np.floor(x)), int(np.floor(y))
    x, y = x - F(i), y - F(j)
    red, green, blue = ZERO, ZERO, ZERO
    for k in range(4):
        across, down = k & 1, k >> 1
        share = (x if across else ONE - x) * (y if down else ONE - y)
        texel = first + (j + down + height) % height * width + (i + across + width) % width
        red += share * bodies.decode[bodies.texels[texel, 0]]
        green += share * bodies.decode[bodies.texels[texel, 1]]
        blue += share * bodies.decode[bodies.texels[texel, 2]]
    return red, green, blue


@compiled(inline="always")
def _sample(x, y, f, middle, screen, bodies, view, lights, shadows):
    """Linear light of one sample at (x, y) that sees triangle f."""
    sx, sy = (x - middle[0]) / view.focal, (middle[1] - y) / view.focal
    toward = _along(_along((-view.back[0], -view.back[1], -view.back[2]), sx, view.right), sy, view.up)
    reach = (view.floor - view.eye[2]) / toward[2] if toward[2] < F(-1e-6) else FAR
    n, base, shine, sky, mist = (ZERO, ZERO, ONE), view.floor_colour, ZERO, ONE, ZERO
    hit = False
    if f != NOTHING:
        i, j, k = bodies.faces[f, 0], bodies.faces[f, 1], bodies.faces[f, 2]
        a = (screen[i, 0], screen[i, 1], screen[i, 2])
        b = (screen[j, 0], screen[j, 1], screen[j, 2])
        u, v, w, away = _weights(x, y, a, b, (screen[k, 0], screen[k, 1], screen[k, 2]))
        if away < reach:
            hit, reach, looks = True, away, bodies.looks
            nx = u * looks[i, 0] + v * looks[j, 0] + w * looks[k, 0]
            ny = u * looks[i, 1] + v * looks[j, 1] + w * looks[k, 1]
            nz = u * looks[i, 2] + v * looks[j, 2] + w * looks[k, 2]
            unit = ONE / np.sqrt(nx * nx + ny * ny + nz * nz + F(1e-20))
            n = (nx * unit, ny * unit, nz * unit)
            red = u * looks[i, 3] + v * looks[j, 3] + w * looks[k, 3]
            green = u * looks[i, 4] + v * looks[j, 4] + w * looks[k, 4]
            blue = u * looks[i, 5] + v * looks[j, 5] + w * looks[k, 5]
            if bodies.page[f] >= 0:
                s = u * looks[i, 8] + v * looks[j, 8] + w * looks[k, 8]
                t = u * looks[i, 9] + v * looks[j, 9] + w * looks[k, 9]
                paint = _painted(bodies, bodies.page[f], s, t)
                red, green, blue = red * paint[0], green * paint[1], blue * paint[2]
            base = (red, green, blue)
            shine, sky = looks[i, 6], u * looks[i, 7] + v * looks[j, 7] + w * looks[k, 7]
    p = _along(view.eye, reach, toward)
    if not hit:
        far = min(np.hypot(p[0] - lights.centre[0], p[1] - lights.centre[1]) / view.fade, ONE)
        mist = max((far - F(0.35)) / F(0.65), ZERO)
        mist *= mist * (F(3) - F(2) * mist)
        if mist > F(0.995):
            return view.backdrop
        sky = _floor_sky(shadows.floor_sky, lights, p)
    # a fixed but unordered turn of the taps at each sample hides their pattern
    turn = F(6.2832) * ((F(0.7548777) * x + F(0.5698403) * y) % ONE)
    key = _key_light(shadows, lights, p, n, turn)
    red, green, blue = _reflected(lights, n, toward, base, shine, key, sky)
    back = view.backdrop
    return red + (back[0] - red) * mist, green + (back[1] - green) * mist, blue + (back[2] - blue) * mist


@compiled(inline="always")
def _alike(depth, triangle, patch, page, top, left, samples):
    """Whether all samples of a pixel see one smooth patch without fold or texture: then one speaks for all."""
    f, nearest, farthest = triangle[top, left], ZERO, FAR
    if f != NOTHING and page[f] >= 0:
        return False
    for j in range(top, top + samples):
        for i in range(left, left + samples):
            g = triangle[j, i]
            if g != f and (g == NOTHING or f == NOTHING or patch[g] != patch[f]):
                return False
            nearest, farthest = max(nearest, depth[j, i]), min(farthest, depth[j, i])
    return nearest <= farthest * F(1.02)


@compiled()
def shade(samples, depth, triangle, screen, bodies, view, lights, shadows, encode, out):
    """sRGB picture `out` (h, w, 3) of what `rasterize` left visible, samples x samples a pixel.

    `encode` is `encoding()`."""
    middle, step = (F(triangle.shape[1]) / F(2), F(triangle.shape[0]) / F(2)), samples // 2
    for pixel in range(out.shape[0] * out.shape[1]):
        top, left = pixel // out.shape[1] * samples, pixel % out.shape[1] * samples
        red, green, blue = ZERO, ZERO, ZERO
        count = 1 if _alike(depth, triangle, bodies.patch, bodies.page, top, left, samples) else samples * samples
        for k in range(count):
            y, x = (top + k // samples, left + k % samples) if count > 1 else (top + step, left + step)
            light = _sample(F(x) + F(0.5), F(y) + F(0.5), triangle[y, x], middle, screen, bodies, view, lights, shadows)
            red += min(light[0], ONE)
            green += min(light[1], ONE)
            blue += min(light[2], ONE)
        share, y, x = F(len(encode) - 1) / F(count), top // samples, left // samples
        out[y, x, 0] = encode[int(max(red, ZERO) * share)]
        out[y, x, 1] = encode[int(max(green, ZERO) * share)]
        out[y, x, 2] = encode[int(max(blue, ZERO) * share)]
