"""Fracture patterns of a square plate hit at a point: a sketch of what glass does, not a simulation.

- The hit punches out a small plug (Hertz's cone crack).
- Radial cracks leave it. Their number rises with the square root of the speed (Vandenberghe, Vermorel and
  Villermaux 2013). The first four run to the corners, the yield lines of a plate held along its sides (Johansen
  1943); each further one halves the widest sector, where nothing has relieved the tension yet.
- The sectors bend outwards and break across, at a distance in proportion to their width: wedges of one angle are
  alike at every size. How far out that goes rises with the speed.
- Far from the hit a radial crack may fork. A crack ends where it meets another.

Angles, paths, breaks and forks vary at random, so that two equal hits differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from deepfracture.types import Floats, Floats32, Labels

FINE = 3
"""Cracks are drawn on a grid finer by this factor; odd, so that its pixels share centres with the coarse ones."""
STEP = 0.02
"""Length of a crack's straight pieces [m]."""
RADIAL_CRACKS = 10.0
"""Their number at full speed."""
PLUG = (0.1, 0.06)
"""Radius of the plug at rest, and what full speed adds to it [m]."""
REACH = (0.25, 0.75)
"""The same for the distance from the hit within which sectors break across [m]."""
ASPECT = 1.8
"""Length of a broken piece of a sector over its width."""
SKIPPED = 0.08
"""Chance that a sector does not break where it might."""
FORKED = 0.4
"""Chance that a radial crack forks, at full speed."""
FORK_ANGLE = 0.45
"""[rad]"""
ANGLE_JITTER = 0.06
"""Standard deviation of a radial crack's angle, over the width of its sectors."""
TURN = 0.12
"""Standard deviation of a crack's heading [rad] after one metre."""
BREAK_JITTER = 0.05
"""Standard deviation of the logarithm of the distance at which a sector breaks across."""
SMALLEST = 8
"""Pixels of the coarse grid; smaller pieces join their neighbours."""


@dataclass(frozen=True, eq=False)
class Plate:
    """A broken plate [-1, 1]^2 on r x r pixels; the first index is x."""

    labels: Labels
    """Fragment 1..n of each pixel, shape (r, r)."""
    distance: Floats32
    """Distance [m] of each pixel's centre to the nearest edge of a fragment, cracked or not, shape (r, r)."""


def random_hits(count: int, rng: np.random.Generator) -> Floats:
    """Rows x, y [m] and speed as a share of the greatest, shape (count, 3)."""
    return rng.uniform((-0.7, -0.7, 1 / 6), (0.7, 0.7, 1.0), (count, 3))


def break_plate(hit: Floats, resolution: int, rng: np.random.Generator) -> Plate:
    """The pattern of one hit (x, y, speed)."""
    sheet = _Sheet(FINE * resolution)
    plug = PLUG[0] + PLUG[1] * hit[2]
    angles = _radial_angles(hit, rng)
    radials = [_wander(hit[:2] + plug * _unit(angle), angle, rng) for angle in angles]
    circle = hit[:2] + plug * _unit(np.linspace(0, 2 * np.pi, 32))
    for crack in (circle, *radials):
        sheet.draw(crack)
    ahead = np.append(angles[1:], angles[0] + 2 * np.pi)
    for left, right, width in zip(radials, [*radials[1:], radials[0]], ahead - angles, strict=True):
        for chord in _breaks_across(hit, plug, left, right, width, rng):
            sheet.draw(chord)
    for radial in radials:
        if rng.random() < FORKED * hit[2]:
            sheet.draw(sheet.until_it_meets(_fork(radial, rng)))
    return sheet.plate()


def _radial_angles(hit: Floats, rng: np.random.Generator) -> Floats:
    """Directions of the radial cracks [rad], rising, at most one turn apart."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) - hit[:2]
    angles = np.sort(np.arctan2(corners[:, 1], corners[:, 0]))
    for _ in range(round(RADIAL_CRACKS * np.sqrt(hit[2])) - len(angles)):
        gaps = _gaps(angles)
        widest = int(gaps.argmax())
        angles = np.insert(angles, widest + 1, angles[widest] + gaps[widest] / 2)
    gaps = _gaps(angles)
    return angles + ANGLE_JITTER * np.minimum(gaps, np.roll(gaps, 1)) * rng.uniform(-1, 1, len(angles)) * np.sqrt(3)


def _gaps(angles: Floats) -> Floats:
    return np.diff(angles, append=angles[0] + 2 * np.pi)


def _wander(start: Floats, heading: float, rng: np.random.Generator) -> Floats:
    """A crack that runs on, turning a little at random, until it has left the plate, shape (n, 2)."""
    turns = TURN * np.sqrt(STEP) * rng.normal(size=int(3 / STEP))
    steps = STEP * _unit(heading + np.cumsum(turns))
    path = np.vstack([start, start + np.cumsum(steps, axis=0)])
    outside = np.abs(path).max(axis=1) > 1
    return path[: int(outside.argmax()) + 1 if outside.any() else len(path)]


def _breaks_across(
    hit: Floats, plug: float, left: Floats, right: Floats, width: float, rng: np.random.Generator
) -> list[Floats]:
    """Cracks from one radial to the next, slightly bent, each shape (3, 2)."""
    found, radius, reach = [], plug, REACH[0] + REACH[1] * hit[2]
    while True:
        radius *= 1 + ASPECT * width
        if radius > reach:
            return found
        a, b = (_at_radius(path, hit[:2], radius * np.exp(BREAK_JITTER * rng.normal())) for path in (left, right))
        if rng.random() < SKIPPED or a is None or b is None:
            continue
        middle = (a + b) / 2
        found.append(np.array([a, middle + rng.uniform(0, 0.15) * (middle - hit[:2]), b]))


def _at_radius(path: Floats, centre: Floats, radius: float) -> Floats | None:
    """The first point of a crack at that distance from the hit; None if it leaves the plate before."""
    beyond = np.linalg.norm(path - centre, axis=1) >= radius
    return path[int(beyond.argmax())] if beyond.any() else None


def _fork(radial: Floats, rng: np.random.Generator) -> Floats:
    """A branch of a radial crack, from the outer half of its way."""
    start = int(rng.uniform(0.4, 0.8) * (len(radial) - 1))
    along = radial[start + 1] - radial[start]
    return _wander(radial[start], np.arctan2(along[1], along[0]) + FORK_ANGLE * rng.choice((-1, 1)), rng)


def _unit(angle: float | Floats) -> Floats:
    """Unit vectors, shape (..., 2)."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


class _Sheet:
    """The plate as a fine picture on which cracks are drawn."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.image = Image.new("L", (size, size))

    def draw(self, crack: Floats) -> None:
        pixels = (crack[:, ::-1] + 1) * self.size / 2 - 0.5  # a picture's first coordinate is the array's second
        ImageDraw.Draw(self.image).line([tuple(pixel) for pixel in pixels], fill=255, width=2)

    def until_it_meets(self, crack: Floats) -> Floats:
        """The crack up to the first other one on its way, its own root left aside."""
        pixels = np.clip(((crack + 1) * self.size / 2).astype(int), 0, self.size - 1)
        met = np.asarray(self.image)[pixels[:, 0], pixels[:, 1]] > 0
        clear = int((~met).argmax())
        return crack[: clear + int(met[clear:].argmax()) + 1] if met[clear:].any() else crack

    def plate(self) -> Plate:
        pieces, _ = ndimage.label(np.asarray(self.image) == 0)
        labels = join_small(pieces, SMALLEST * FINE**2)
        edge = np.ones((self.size + 2, self.size + 2), bool)
        edge[1:-1, 1:-1] = cracked(labels)
        spacing = 2 / self.size
        distance = ndimage.distance_transform_edt(~edge)[1:-1, 1:-1] * spacing
        middle = slice(FINE // 2, None, FINE)
        return Plate(join_small(labels[middle, middle], 1), distance[middle, middle].astype(np.float32))


def cracked(labels: Labels) -> np.ndarray:
    """Pixels whose next neighbour along either axis is of another fragment: closed lines, one pixel wide."""
    lines = np.zeros(labels.shape, bool)
    lines[:-1] |= labels[:-1] != labels[1:]
    lines[:, :-1] |= labels[:, :-1] != labels[:, 1:]
    return lines


def join_small(pieces: np.ndarray, smallest: int) -> Labels:
    """Labels 1..n of the pieces that hold `smallest` pixels; all else takes the label of its nearest.

    Without any such piece the plate is whole."""
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    keep = (sizes >= smallest) & (sizes > 0)
    if not keep.any():
        return np.ones(pieces.shape, np.int32)
    names = np.where(keep, np.cumsum(keep), 0).astype(np.int32)[pieces]
    nearest = ndimage.distance_transform_edt(names == 0, return_distances=False, return_indices=True)
    return names[tuple(np.asarray(nearest))]
