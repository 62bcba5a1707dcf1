"""Stills: what a break looks like, for readers and for looking at results."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from deepfracture.recording.motion import break_frame
from deepfracture.recording.surface import surfaces
from deepfracture.render.camera import ELEVATION, frame_action, frame_points
from deepfracture.render.film import in_threads
from deepfracture.render.renderer import Instance, RecordingRenderer, Renderer
from deepfracture.runtime.files import atomic_file
from deepfracture.types import Fragments, Recording, Shape

STILL_SAMPLES = 3
"""Samples a pixel and axis."""
STILL_TAPS = 64
"""On a soft shadow: no grain in a picture that one looks at for long."""
STRIP_GAP = 6
"""Pixels between the pictures of a strip."""
BEFORE, AFTER_HIT = 0.06, 0.10
"""Seconds before the first fragment appears, and after it, of the pictures "before" and "hit"."""


def exploded(
    fragments: Fragments,
    path: str | os.PathLike,
    *,
    shape: Shape | None = None,
    factor: float = 0.5,
    size: tuple[int, int] = (800, 600),
    azimuth: float = -60.0,
    elevation: float = ELEVATION,
) -> None:
    """A PNG of the fragments, each moved away from the middle by `factor` times its distance.

    shape: what broke; with it the fragments keep its paint. azimuth, elevation: where it is seen from [degrees]."""
    centres = np.array([piece.centre for piece in fragments])
    masses = np.array([piece.mass for piece in fragments])
    middle = masses @ centres / masses.sum()
    offsets = factor * (centres - middle)
    moved = [piece.mesh.vertices + offset for piece, offset in zip(fragments, offsets, strict=True)]
    points = np.concatenate(moved)
    camera = frame_points(points, size[0] / size[1], azimuth=azimuth, elevation=elevation)
    renderer = Renderer(
        [Instance(surfaces(piece.mesh, piece.source, whole=shape)) for piece in fragments],
        camera,
        size=size,
        samples=STILL_SAMPLES,
        taps=STILL_TAPS,
        floor=float(points[:, 2].min()),
        radius=1.3 * float(np.linalg.norm(points - camera.target, axis=1).max()),
    )
    turns = np.tile(np.eye(3), (len(fragments), 1, 1))
    _save(renderer.picture(turns, offsets, np.ones(len(fragments), bool)), path)


def before_hit_after(recording: Recording, path: str | os.PathLike, *, size: tuple[int, int] = (480, 400)) -> None:
    """A PNG strip of three pictures: just before the break, just after it, and the end.

    `size` is that of one picture. Nothing broke: the beginning, the middle and the end."""
    last, hit = recording.frames - 1, break_frame(recording)
    if hit is None:
        frames = [0, last // 2, last]
    else:
        early, late = round(BEFORE / recording.frame_time), round(AFTER_HIT / recording.frame_time)
        frames = [max(hit - 1 - early, 0), min(hit + late, last), last]
    camera = frame_action(recording, size[0] / size[1])
    renderer = RecordingRenderer(recording, camera, size=size, samples=STILL_SAMPLES, taps=STILL_TAPS)
    gap = np.full((size[1], STRIP_GAP, 3), 255, np.uint8)
    first, second, third = in_threads(renderer.picture, frames)
    _save(np.concatenate([first, gap, second, gap, third], axis=1), path)


def _save(picture: NDArray[np.uint8], path: str | os.PathLike) -> None:
    from PIL import Image

    with atomic_file(path) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG", optimize=True)
