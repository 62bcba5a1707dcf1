"""Twenty seconds of things that break: `make film`.

    python examples/film.py --out runs/film

Six shots with shapes that come with the program, each a scene, a breaker and a pace; the pictures come from the
program's own rasteriser. film.mp4 is the film, and stills/ holds one moment of each shot.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from starting import start

import deepfracture as df
from deepfracture.recording.motion import break_frame
from deepfracture.render.camera import frame_action
from deepfracture.render.film import FILM_RATE, in_threads, write_pictures
from deepfracture.render.renderer import RecordingRenderer
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import stage
from deepfracture.types import Appearance, Finish, Ints, Recording, Shape

WORLD_RATE = 240
"""Frames a second of the recordings: enough for slow motion."""
INK = (70, 66, 62)
STILLS = "stills"


@dataclass(frozen=True)
class Shot:
    """Some seconds of the film."""

    shape: str
    material: str
    breaker: str
    speed: float
    """Of the ball [m/s]."""
    seconds: float
    """In the film."""
    pace: float
    """World seconds in a second of the film: 1 is real time, less is slow motion."""
    lead: float
    """World seconds before the break at which it begins."""
    colour: tuple[int, int, int] | None = None
    """sRGB of the surface."""
    seed: int = 0
    still: float = 0.5
    """Which moment is kept as a still, as a share of the shot."""

    @property
    def caption(self) -> str:
        slow = "" if self.pace == 1 else f", {1 / self.pace:.0f} times slower"
        return f"{self.shape.replace('_', ' ')}, {self.material}, {self.breaker}{slow}"


SHOTS = (
    Shot("pot", "plaster", "learned", 18, 4.0, 0.08, 0.02, seed=0, still=0.45),
    Shot("mug", "porcelain", "physical", 50, 3.0, 0.1, 0.02, (206, 222, 236), still=0.4),
    Shot("bunny", "plaster", "learned", 16, 3.5, 1, 0.3, (226, 220, 208), still=0.14),
    Shot("letter_a", "stone", "physical", 16, 3.0, 0.25, 0.06, (150, 150, 146), still=0.5),
    Shot("bowl", "glass", "physical", 45, 3.0, 0.06, 0.015, (122, 178, 160), still=0.45),
    Shot("chair", "concrete", "physical", 12, 3.5, 1, 0.3, (128, 132, 138), still=0.16),
)
HEADING = 200.0
"""Where the balls come from [degrees]."""


def film(
    out: Path = Path("runs/film"),
    *,
    size: tuple[int, int] = (960, 544),
    samples: int = 2,
    shots: int = len(SHOTS),
    length: float = 1.0,
    resolution: int = 64,
) -> int:
    """Break, draw and join all shots; returns the number of pictures.

    Args:
        out: folder of film.mp4 and stills.
        size: width and height, multiples of 16 [pixel].
        samples: per pixel and axis.
        shots: how many of them, from the first.
        length: of each shot, as a share of its own.
        resolution: voxels along each axis for physical.
    """
    if not 1 <= shots <= len(SHOTS) or not 0 < length <= 1:
        raise df.BadInput(f"shots must be 1 to {len(SHOTS)} and length in (0, 1], got {shots} and {length}")
    chosen = [replace(shot, seconds=shot.seconds * length) for shot in SHOTS[:shots]]

    def pictures() -> Iterator[NDArray[np.uint8]]:
        for number, shot in enumerate(chosen):
            with stage(f"break {shot.shape}"):
                recording = broken(shot, resolution)
            with stage(f"draw {shot.shape}"):
                yield from drawn(shot, recording, size, samples, out / STILLS / f"{number + 1}_{shot.shape}.jpg")

    return write_pictures(pictures(), out / "film.mp4", size=size)


def broken(shot: Shot, resolution: int) -> Recording:
    """The world from shortly before the break to the end of the shot."""
    shape = dressed(shot)
    scene = df.throw_scene(shape, speed=shot.speed, heading=HEADING, material=shot.material, seed=shot.seed)
    flight = 4 / shot.speed
    scene = replace(
        scene, duration=flight + shot.seconds * shot.pace + 0.2, frame_rate=WORLD_RATE, steps_per_second=WORLD_RATE
    )
    breaker = df.breaker(shot.breaker, shape, material=shot.material, resolution=resolution)
    recording = df.run(scene, breaker, shapes=[shape]).recording
    hit = break_frame(recording)
    if hit is None:
        raise df.BadInput(f"{shot.caption}: nothing broke; give the shot a faster ball")
    return cut_out(recording, max(0, hit - round(shot.lead * WORLD_RATE)), recording.frames)


def dressed(shot: Shot) -> Shape:
    """The shape in its colour; the pot wears the glaze of the slow-motion example."""
    if shot.colour is None:
        return import_module("04_slow_motion").glazed(np.random.default_rng(shot.seed))
    shape = df.load(shot.shape)
    plain = Appearance(np.zeros(len(shape.mesh.faces), np.int32), (Finish("", shot.colour),))
    return replace(shape, appearance=plain)


def cut_out(recording: Recording, first: int, stop: int) -> Recording:
    """The frames from `first` to before `stop`, for pictures: where everything is, not how fast."""
    tracks = []
    for track in recording.tracks:
        low, high = max(first, track.start), min(stop, track.stop)
        if low < high:
            kept = slice(low - track.start, high - track.start)
            poses = {"positions": track.positions[kept], "quats_wxyz": track.quats_wxyz[kept]}
            tracks.append(replace(track, start=low - first, rigid=None, **poses))
    return replace(recording, tracks=tuple(tracks))


def drawn(
    shot: Shot, recording: Recording, size: tuple[int, int], samples: int, still: Path
) -> Iterator[NDArray[np.uint8]]:
    """The pictures of a shot, each with its caption; one is kept."""
    count = max(2, round(shot.seconds * FILM_RATE))
    frames: Ints = np.rint(np.arange(count) / FILM_RATE * shot.pace / recording.frame_time).astype(int)
    frames = np.minimum(frames, recording.frames - 1)
    shown = cut_out(recording, 0, int(frames[-1]) + 1)
    camera = frame_action(shown, size[0] / size[1])
    renderer = RecordingRenderer(shown, camera, size=size, samples=samples)
    kept = round(shot.still * (count - 1))
    for number, picture in enumerate(in_threads(renderer.picture, [int(frame) for frame in frames])):
        titled = captioned(picture, shot.caption)
        if number == kept:
            with atomic_file(still) as temporary:
                Image.fromarray(titled).save(temporary, format="JPEG", quality=86, optimize=True)
        yield titled


def captioned(picture: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """A line of text at the top on the left, where nothing falls."""
    image = Image.fromarray(picture)
    size = max(8, picture.shape[0] // 28)
    ImageDraw.Draw(image).text((size, size), text, fill=INK, font_size=size)
    return np.asarray(image)


if __name__ == "__main__":
    start(film)
