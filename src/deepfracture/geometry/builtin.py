"""The shapes that come with the program. z is up; all are closed, of one body, thick-walled."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from deepfracture.geometry.collapse import collapse_short_edges
from deepfracture.geometry.normalise import normalise
from deepfracture.geometry.read import read_mesh
from deepfracture.geometry.solids import (
    box,
    extruded_quads,
    fillet,
    resample,
    revolve,
    spline,
    tube,
    union,
    union_of_boxes,
)
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Floats, Mesh, Shape

WALL = 0.18
"""Thickness of vessel walls: five voxels of the 64^3 grid are 0.156."""


def _vessel(outside: Floats, wall: float, floor: float, rounding: float) -> list[Floats]:
    """The profile of an open vessel with an even wall.

    outside: curve (n, 2) of (radius, z) from the foot (z = 0) to the lip. floor: thickness of
    the bottom. rounding: radius with which the inner wall meets the floor."""
    tangent = np.gradient(outside, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    outward = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    angle = np.linspace(0, np.pi, 40)[:, None]
    lip = outside[-1] - wall / 2 * outward[-1]
    lip = lip + wall / 2 * (np.cos(angle) * outward[-1] + np.sin(angle) * tangent[-1])
    inside = (outside - wall * outward)[::-1]
    inside = inside[: int(np.argmax(inside[:, 1] < floor + rounding))]
    end, down = inside[-1], inside[-1] - inside[-2]
    corner = end + down * (end[1] - floor) / -down[1]
    flat = corner - [min(corner[0] * 0.9, 1.5 * rounding), 0]
    bottom = np.array([[0.0, 0.0], outside[0]])
    return [bottom, outside, lip, inside, fillet(end, corner, flat), np.array([flat, [0.0, floor]])]


def _rounded_foot(curve: Floats, radius: float) -> Floats:
    """The curve with its lower end (radius, 0) turned in to the bottom by a fillet."""
    start = int(np.argmax(curve[:, 1] > radius))
    return np.concatenate([fillet(curve[0] - [radius, 0], curve[0], curve[start])[:-1], curve[start:]])


def _pot() -> Mesh:
    """An earthenware vase: flared foot, full belly, narrow neck, rolled lip."""
    outside = spline(
        [
            (0.46, 0.0),
            (0.43, 0.08),
            (0.52, 0.3),
            (0.74, 0.68),
            (0.83, 1.05),
            (0.72, 1.42),
            (0.47, 1.7),
            (0.41, 1.86),
            (0.52, 2.06),
        ]
    )
    return revolve(_vessel(_rounded_foot(outside, 0.04), 0.19, 0.21, 0.14), 0.047)


def _bowl() -> Mesh:
    outside = spline([(0.44, 0.0), (0.43, 0.09), (0.62, 0.22), (0.86, 0.5), (0.97, 0.8)])
    return revolve(_vessel(_rounded_foot(outside, 0.03), WALL, 0.24, 0.1), 0.047)


def _plate() -> Mesh:
    outside = spline([(0.56, 0.0), (0.62, 0.015), (0.75, 0.09), (0.96, 0.15)])
    return revolve(_vessel(outside, WALL, WALL, 0.02), 0.047)


def _base() -> Mesh:
    """A squat turned pedestal: square-edged plinth, waist, and a slab on top."""
    corners = [(0, 0), (1.0, 0), (1.0, 0.26)]
    waist = spline([(0.86, 0.34), (0.68, 0.5), (0.64, 0.72), (0.72, 0.88)])
    top = [(0.9, 0.96), (0.9, 1.16)]
    pieces = [np.array(corners[:2]), np.array(corners[1:]), fillet(corners[2], (0.99, 0.34), waist[0]), waist]
    pieces += [fillet(waist[-1], (0.76, 0.95), top[0]), np.array(top), np.array([top[1], (0.0, 1.16)])]
    return revolve([np.asarray(piece, float) for piece in pieces], 0.06)


def _mug() -> Mesh:
    radius, height = 0.62, 1.5
    outside = _rounded_foot(resample([(radius, 0), (radius, height - WALL / 2)], 0.01), 0.06)
    body = revolve(_vessel(outside, WALL, 0.2, 0.1), 0.05)
    angle = np.linspace(-0.5, 0.5, 200) * np.pi * 1.1
    middle = radius - 0.03
    path = np.column_stack([middle + 0.5 * np.cos(angle), 0 * angle, 0.76 + 0.46 * np.sin(angle)])
    # Both ends lie within the wall, so the handle does not show inside.
    handle = tube(path, (0, 1, 0), (0.2, 0.25), 0.05)
    return collapse_short_edges(union([body, handle]), 0.018)


def _bar() -> Mesh:
    return box((2.0, 0.4, 0.4), 0.08)


def _letter_a() -> Mesh:
    """The letter A, upright: two legs that lean together, and a crossbar."""
    foot, tip, width = 0.86, 0.24, 0.46  # outer half width at the bottom and the top; width of a leg

    def outer(z: float) -> tuple[float, float]:
        return foot + (tip - foot) * (z + 1) / 2, z

    def inner(z: float) -> tuple[float, float]:
        return outer(z)[0] - width, z

    low, high = -0.5, -0.14
    crotch = 2 * (foot - width) / (foot - tip) - 1  # where the legs meet
    half = [
        ([inner(-1), outer(-1), outer(low), inner(low)], 5, 6),
        ([inner(low), outer(low), outer(high), inner(high)], 5, 4),
        ([inner(high), outer(high), outer(crotch), inner(crotch)], 5, 5),
        ([inner(crotch), outer(crotch), outer(1), (0.0, 1.0)], 5, 7),
        ([(0.0, low), inner(low), inner(high), (0.0, high)], 3, 4),
    ]
    other = [([(-p[0], p[1]) for p in (q[1], q[0], q[3], q[2])], nu, nv) for q, nu, nv in half]
    return extruded_quads([*half, *other], 0.44, 5)


def _chair() -> Mesh:
    """A sturdy chair: four legs, a thick seat, a solid back with an opening."""
    half, leg, seat, thick = 0.45, 0.2, 0.86, 0.2
    across = np.concatenate([np.linspace(-half, leg - half, 4), np.linspace(leg - half, half - leg, 9)[1:-1]])
    across = np.concatenate([across, np.linspace(half - leg, half, 4)])
    top = 2.0
    heights = [
        np.linspace(0, seat, 14),
        np.linspace(seat, seat + thick, 4),
        np.linspace(seat + thick, 1.36, 6),
    ]
    heights += [np.linspace(1.36, 1.66, 6), np.linspace(1.66, top, 7)]
    up = np.unique(np.concatenate(heights))
    feet = [(x, y) for x in (-half, half - leg) for y in (-half, half - leg)]
    parts = [((x, y, 0), (x + leg, y + leg, seat)) for x, y in feet]
    parts += [((-half, -half, seat), (half, half, seat + thick))]
    parts += [((x, half - leg, seat), (x + leg, half, top)) for x in (-half, half - leg)]
    parts += [((-half, half - leg, 1.66), (half, half, top)), ((-half, half - leg, seat), (half, half, 1.36))]
    return union_of_boxes([across, across, up], parts)


def _bunny() -> Mesh:
    """The Stanford bunny (902 triangles; its licence lies beside it), turned so that z is up."""
    mesh = read_mesh(Path(__file__).parent / "shapes" / "bunny.obj")
    return Mesh(mesh.vertices[:, [0, 2, 1]] * [1, -1, 1], mesh.faces)


_MAKERS: dict[str, Callable[[], Mesh]] = {
    "pot": _pot,
    "mug": _mug,
    "bowl": _bowl,
    "plate": _plate,
    "bar": _bar,
    "letter_a": _letter_a,
    "chair": _chair,
    "base": _base,
    "bunny": _bunny,
}
BUILTIN: tuple[str, ...] = tuple(_MAKERS)
"""Names of the shapes that come with the program."""


def plain_name(name: str) -> str:
    """The name as in BUILTIN: "A", "letter-a" and "letter A" are "letter_a"."""
    plain = name.strip().lower().replace("-", "_").replace(" ", "_")
    return "letter_a" if plain == "a" else plain


def builtin(name: str) -> Shape:
    """A built-in shape in its body frame, z up. Raises BadInput for an unknown name."""
    plain = plain_name(name)
    if plain not in _MAKERS:
        raise BadInput(
            f"{name!r}: neither a file nor a built-in shape; built in are {', '.join(BUILTIN)}"
            f"{did_you_mean(plain, BUILTIN)}"
        )
    return _made(plain)


@cache
def _made(plain: str) -> Shape:
    return normalise(_MAKERS[plain](), plain)
