"""Poses of a recording's bodies, frame by frame, and the keys that suffice to repeat them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deepfracture.geometry.rotations import continuous_quats, rotation_matrices
from deepfracture.types import Floats, Ints, Recording, Track

KEY_TOL = 1e-6
"""[m] and quaternion units: a body that moves less than this is at rest; float32 noise at unit scale."""


def exists(track: Track, frame: int) -> bool:
    return track.start <= frame < track.stop


def pose(track: Track, frame: int) -> Floats:
    """world_from_mesh at a frame in which the body exists, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrices(track.quats_wxyz[frame - track.start])
    matrix[:3, 3] = track.positions[frame - track.start]
    return matrix


def break_frame(recording: Recording) -> int | None:
    """First frame with a fragment in it, None when nothing broke."""
    return min((track.start for track in recording.tracks if track.kind == "fragment"), default=None)


def floor_height(recording: Recording) -> float | None:
    """Top of the floor [m], None without a floor."""
    tops = [
        (track.mesh.vertices @ pose(track, track.start)[:3, :3].T)[:, 2].max() + track.positions[0, 2]
        for track in recording.tracks
        if track.kind == "floor" and len(track.positions)
    ]
    return float(max(tops)) if tops else None


def keys(values: NDArray, tolerance: float = KEY_TOL) -> Ints:
    """Frames to keep so that linear interpolation stays within `tolerance`, shape (k,).

    Runs at rest keep their ends; one key is enough for a body that never moves."""
    kept = [0]
    for i in range(1, len(values) - 1):
        rest = values[kept[-1]]
        if np.abs(values[i] - rest).max() > tolerance or np.abs(values[i + 1] - rest).max() > tolerance:
            kept.append(i)
    last = len(values) - 1
    if last and (len(kept) > 1 or np.abs(values[last] - values[0]).max() > tolerance):
        kept.append(last)
    return np.array(kept)


def similarity(recording: Recording) -> tuple[float, Floats, Floats]:
    """Scale, rotation (3, 3) and shift (3,) that lead from the world to the user's coordinates."""
    user = recording.user_from_world
    scale = float(np.cbrt(np.linalg.det(user[:3, :3])))
    return scale, user[:3, :3] / scale, user[:3, 3]


def pivot(track: Track) -> Floats:
    """The point of the mesh frame about which a body turns, shape (3,): its centre of mass, where that is known.

    Programs draw straight lines between the frames of a pivot, as the centre of mass of a flying body does."""
    return np.zeros(3) if track.rigid is None else track.rigid.centre


def pivot_positions(track: Track) -> Floats:
    """Where the pivot is in the world, shape (n, 3)."""
    return track.positions + rotation_matrices(continuous_quats(track.quats_wxyz)) @ pivot(track)
