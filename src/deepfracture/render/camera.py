"""Where to look from so that a break fills the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deepfracture.recording.motion import break_frame, exists, pose
from deepfracture.types import Floats, Recording

FIELD = 32.0
"""Vertical field of view [degrees]: a mild telephoto, which keeps proportions true."""
ELEVATION = 17.0
"""Degrees above the horizon."""
MARGIN = 1.12
"""Free space around what must be seen."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera; z is up in the picture."""

    position: Floats
    """World [m], shape (3,)."""
    target: Floats
    """What it looks at, world [m], shape (3,)."""
    field: float = FIELD
    """Vertical field of view [degrees]."""

    @property
    def axes(self) -> Floats:
        """Rows right, up, back of the picture in the world, shape (3, 3)."""
        return _axes(self.position - self.target)


def frame_points(points: ArrayLike, aspect: float, *, azimuth: float, elevation: float = ELEVATION) -> Camera:
    """The closest camera in direction `azimuth`, `elevation` [degrees] that sees all points (n, 3).

    `aspect` is width over height of the picture."""
    points = np.asarray(points, float)
    a, e = np.radians(azimuth), np.radians(elevation)
    back = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    axes = _axes(back)
    seen = points @ axes.T
    slope = np.tan(np.radians(FIELD / 2)) / MARGIN * np.array([aspect, 1.0])
    centre, depth = np.zeros(2), 0.0
    for k in range(2):
        # a point stays in view while |x - c| <= slope (d - z): each side is a line in (c, d)
        right, left = (seen[:, k] + slope[k] * seen[:, 2]).max(), (-seen[:, k] + slope[k] * seen[:, 2]).max()
        centre[k] = (right - left) / 2
        depth = max(depth, (right + left) / (2 * slope[k]))
    middle = float(np.median(seen[:, 2]))
    target = np.array([*centre, middle]) @ axes
    return Camera(target + back * (depth - middle), target)


def frame_action(recording: Recording, aspect: float) -> Camera:
    """The camera for a whole recording: the shape, and the fragments that stay near it."""
    return frame_points(_action(recording), aspect, azimuth=_azimuth(recording))


def _axes(back: Floats) -> Floats:
    back = back / np.linalg.norm(back)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def _action(recording: Recording) -> Floats:
    """Corners of the boxes of what matters, shape (n, 3)."""
    hit = break_frame(recording)
    whole = [_corners(recording, "shape", frame) for frame in _times(recording, 0, hit)]
    if hit is None:
        return np.concatenate(whole) if any(map(len, whole)) else _corners(recording, "ball", 0)
    burst = _corners(recording, "fragment", hit)
    centre, radius = burst.mean(axis=0), np.linalg.norm(np.ptp(burst, axis=0)) / 2
    later = np.concatenate([_corners(recording, "fragment", frame) for frame in _times(recording, hit, None)])
    away = np.linalg.norm(later - centre, axis=1)
    # a few pieces may leave the picture: following them would make the break itself small
    reach = np.clip(np.quantile(away, 0.95), 1.2 * radius, 2.6 * radius)
    early = np.concatenate(whole)
    near = np.linalg.norm(early - centre, axis=1) <= reach
    return np.concatenate([burst, early[near], later[away <= reach]])


def _times(recording: Recording, start: int, stop: int | None) -> list[int]:
    last = (recording.frames if stop is None else stop) - 1
    return sorted({round(float(t)) for t in np.linspace(start, max(start, last), 12)})


def _corners(recording: Recording, kind: str, frame: int) -> Floats:
    corners = [np.zeros((0, 3))]
    for track in recording.tracks:
        if track.kind == kind and exists(track, frame):
            world = pose(track, frame)
            low, high = track.mesh.bounds
            box = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1).T
            corners.append(box @ world[:3, :3].T + world[:3, 3])
    return np.concatenate(corners)


def _azimuth(recording: Recording) -> float:
    """Degrees: the ball crosses the picture from the left, coming a little towards the viewer's side."""
    hit = break_frame(recording)
    for track in recording.tracks:
        if track.kind == "ball" and len(track.positions):
            # up to the frame before the hit: at the hit itself the ball may have bounced already
            last = len(track.positions) - 1 if hit is None else max(hit - 1 - track.start, 1)
            moved = track.positions[min(last, len(track.positions) - 1)] - track.positions[0]
            if np.hypot(moved[0], moved[1]) > 0.2 * np.linalg.norm(moved) > 0:
                return float(np.degrees(np.arctan2(moved[1], moved[0]))) - 120.0
    return -60.0
