"""The recording as a film: H.264 in an mp4 file, which plays everywhere."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deepfracture.render.camera import frame_action
from deepfracture.render.renderer import RecordingRenderer
from deepfracture.runtime.extras import require
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import track
from deepfracture.types import Recording

FILM_SIZE = (640, 400)
"""Width, height [pixel], multiples of 16 as H.264 wants them."""
FILM_RATE = 30
"""Pictures a second."""
SAMPLES = 2
"""Samples a pixel and axis."""


def write_film(
    recording: Recording, path: str | os.PathLike, *, size: tuple[int, int] = FILM_SIZE, rate: int = FILM_RATE
) -> int:
    """Write the whole recording in real time; returns the number of pictures.

    The pictures come from our own rasteriser, so no graphics driver is needed; the encoder is the
    ffmpeg that imageio-ffmpeg ships. BadInput without that library, RuntimeError when it has none for this machine."""
    frames = film_frames(recording, rate)
    camera = frame_action(recording, size[0] / size[1])
    renderer = RecordingRenderer(recording, camera, size=size, samples=SAMPLES)
    pictures = track(in_threads(renderer.picture, frames), name="film", total=len(frames))
    return write_pictures(pictures, path, size=size, rate=rate)


def write_pictures(
    pictures: Iterable[NDArray[np.uint8]], path: str | os.PathLike, *, size: tuple[int, int], rate: int = FILM_RATE
) -> int:
    """Write RGB pictures, each (h, w, 3), as a film of one shot after the other; returns their number.

    `size` is width and height [pixel], multiples of 16. Errors as in `write_film`."""
    require("imageio_ffmpeg", extra="render", to="write a film")
    import imageio_ffmpeg

    count = 0
    with atomic_file(path) as temporary:
        writer = imageio_ffmpeg.write_frames(
            str(temporary),
            size,
            fps=rate,
            codec="libx264",
            quality=7,
            output_params=["-preset", "veryfast", "-movflags", "+faststart"],
            ffmpeg_log_level="error",
        )
        writer.send(None)
        try:
            for picture in pictures:
                writer.send(picture)
                count += 1
        finally:
            writer.close()  # also where a picture fails: else the encoder would write on after its file is gone
        _check_whole(temporary)
    return count


def _check_whole(path: Path) -> None:
    """The encoder does not say that it could not write to the end: the boxes of the file have to add up to it
    (ISO 14496-12, 4.2), and its index has to be among them."""
    size, place, kinds = path.stat().st_size, 0, set()
    with open(path, "rb") as file:
        while place < size:
            file.seek(place)
            head = file.read(16)
            length = int.from_bytes(head[:4], "big")
            length = int.from_bytes(head[8:], "big") if length == 1 else length
            kinds.add(head[4:8])
            if length < 8:
                break
            place += length
    if place != size or not {b"moov", b"mdat"} <= kinds:
        raise RuntimeError(f"{path.name}: the encoder broke off")


def film_frames(recording: Recording, rate: int) -> list[int]:
    """The recording's frame shown by each picture of a film at `rate` pictures a second."""
    pictures = int(recording.duration * rate + 1e-6) + 1
    seconds = np.arange(pictures) / rate
    return [int(frame) for frame in np.rint(seconds / recording.frame_time)]


def in_threads(
    draw: Callable[[int], NDArray[np.uint8]], frames: Iterable[int], *, workers: int | None = None
) -> Iterator[NDArray[np.uint8]]:
    """draw(frame) in order, a few drawn ahead on all cores: the compiled loops release Python's lock."""
    workers = workers or os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        ahead = deque()
        for frame in frames:
            ahead.append(pool.submit(draw, frame))
            if len(ahead) > 2 * workers:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
