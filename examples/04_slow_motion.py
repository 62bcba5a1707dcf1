"""A glazed pot breaks in slow motion: glaze outside, bare clay inside, and pieces that fit together.

    python examples/04_slow_motion.py --out DIR

The shipped model breaks the built-in pot, painted with a glaze that is drawn here, as a steel ball strikes it. Three
tenths of a second last three and a half seconds: slow_motion.mp4 is the film, slow_motion.png four moments of it.
"""

from __future__ import annotations

import io
import logging
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from deepfracture.breakers import make_breaker
from deepfracture.fracture import material as preset
from deepfracture.geometry import builtin
from deepfracture.recording.motion import break_frame, exists, pose
from deepfracture.render import write_film
from deepfracture.render.camera import frame_points
from deepfracture.render.renderer import RecordingRenderer
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import stage
from deepfracture.types import Appearance, BadInput, Finish, Floats, Ints, Recording, Shape
from deepfracture.world import Ball, Floor, Placed, Scene, simulate
from deepfracture.world.scene import STEEL

SHAPE, MATERIAL = "pot", "plaster"
TEXTURE = (2048, 1024)
"""Width, height of the painted glaze [texel]: once around, and from foot to lip."""
GROUND, DEEP, CREAM, OCHRE = (38, 116, 128), (19, 58, 78), (244, 238, 222), (226, 164, 62)
RADIUS = 0.15
"""Of the ball [m]."""
ASIDE, RISE, DIVE = -0.3, 0.2, 0.7
"""It is thrown past the pot's middle, so far beside it [m] and above it [m], on the side that is seen, and goes down
so far for each metre along."""
LEAD = 0.02
"""Seconds that the film shows before the ball arrives."""
RATE = 30
"""Pictures of the film a second."""
STILLS = (-0.012, 0.003, 0.04, 0.21)
"""Moments of the strip, seconds after the first picture with fragments."""
VIEW = -120.0
"""Where the strip is seen from [degrees around the vertical]: the ball comes from the left, as in the film."""
GAP = 6
"""Pixels between them."""


def slow_motion(
    out: Path = Path("runs/04_slow_motion"),
    *,
    seed: int = 0,
    speed: float = 22.0,
    seconds: float = 0.3,
    pictures: int = 105,
    size: tuple[int, int] = (640, 400),
    still: tuple[int, int] = (360, 336),
) -> None:
    """Break the pot and write slow_motion.mp4 and slow_motion.png.

    Args:
        out: folder.
        seed: the same seed breaks the same way.
        speed: of the ball [m/s].
        seconds: of the world that the film shows.
        pictures: of the film, shown at 30 a second.
        size: width and height of the film, multiples of 16 [pixel].
        still: width and height of one moment of the strip [pixel].
    """
    if seconds <= LEAD or pictures < 2:
        raise BadInput(f"seconds must be more than {LEAD} and pictures at least 2, got {seconds} and {pictures}")
    with stage("break"):
        recording = broken(glazed(np.random.default_rng([seed, 0])), seed, speed, seconds, pictures)
    if break_frame(recording) is None:
        raise BadInput(f"speed {speed} breaks nothing within {seconds} s, throw faster or film longer")
    with stage("film"):
        # told that its frames are further apart, the film takes its time
        write_film(replace(recording, frame_time=1 / RATE), out / "slow_motion.mp4", size=size, rate=RATE)
    with stage("strip"):
        strip(recording, out / "slow_motion.png", still)


def glazed(rng: np.random.Generator) -> Shape:
    """The built-in pot, painted outside, with a plain glaze on its inner wall."""
    shape = builtin(SHAPE)
    corners, (low, high) = shape.mesh.triangles, shape.mesh.bounds
    turn = np.arctan2(corners[..., 1], corners[..., 0]) / (2 * np.pi)
    turn[:, 1:] = turn[:, :1] + (turn[:, 1:] - turn[:, :1] + 0.5) % 1 - 0.5  # faces across the seam stay narrow
    height = (corners[..., 2] - low[2]) / (high[2] - low[2])
    middle, area = corners.mean(axis=1), shape.mesh.area_vectors
    within = ((middle * area)[:, :2].sum(axis=1) < 0) & (middle[:, 2] > low[2] + 0.01)
    finishes = Finish("painted glaze", texture=painted_glaze(rng)), Finish("plain glaze", colour=CREAM)
    look = Appearance(within.astype(np.int32), finishes, uv=np.stack([turn, height], axis=-1).astype(np.float32))
    return replace(shape, appearance=look)


def painted_glaze(rng: np.random.Generator) -> bytes:
    """Bands, waves, flowers and a spatter of drops, as a PNG."""
    width, height = TEXTURE
    image = Image.new("RGB", TEXTURE, GROUND)
    draw = ImageDraw.Draw(image)

    def dot(x: float, y: float, radius: float, colour: tuple[int, int, int]) -> None:
        for around in (x - width, x, x + width):  # what crosses the seam goes on behind it
            draw.ellipse([around - radius, y - radius, around + radius, y + radius], fill=colour)

    def band(low: float, high: float, colour: tuple[int, int, int]) -> None:
        draw.rectangle([0, round(height * (1 - high)), width, round(height * (1 - low))], fill=colour)

    drops = zip(rng.uniform(0, width, 700), rng.uniform(0, height, 700), rng.exponential(1.6, 700), strict=True)
    for x, y, radius in drops:
        dot(x, y, radius, DEEP)
    band(0.40, 0.66, CREAM)
    for low, high in ((0.0, 0.07), (0.385, 0.40), (0.66, 0.675), (0.92, 1.0)):
        band(low, high, DEEP)
    for low, high in ((0.10, 0.115), (0.875, 0.89)):
        band(low, high, CREAM)
    for x in range(0, width, 3):
        wave = 0.03 * np.sin(2 * np.pi * 20 * x / width)
        dot(x, height * (0.23 + wave), 9, CREAM)
        dot(x, height * (0.76 + wave), 9, CREAM)
    for x in (np.arange(14) + 0.5) * width / 14:
        for angle in np.arange(6) * np.pi / 3:
            dot(x + 40 * np.cos(angle), height * 0.47 + 40 * np.sin(angle), 24, GROUND)
        dot(x, height * 0.47, 20, OCHRE)
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def broken(shape: Shape, seed: int, speed: float, seconds: float, pictures: int) -> Recording:
    """The world around the hit, frame by frame."""
    belly = float(np.hypot(*shape.mesh.vertices[:, :2].T).max())
    foot = -float(shape.mesh.vertices[:, 2].min())
    along, down = np.array([1.0, -DIVE]) / np.hypot(1.0, DIVE)
    away = belly + RADIUS + LEAD * speed
    start = (float(-away * along), ASIDE, foot + RISE - float(away * down))
    ball = Ball(RADIUS, STEEL, start, (speed * float(along), 0.0, speed * float(down)))
    rate = round((pictures - 1) / seconds)
    scene = Scene(
        (Placed(SHAPE, MATERIAL, (0.0, 0.0, foot + 1e-3)),), (ball,), Floor(), duration=(pictures - 0.5) / rate,
        frame_rate=rate, steps_per_second=rate, seed=seed,
    )  # fmt: skip
    material = preset(MATERIAL)
    breaker = make_breaker("learned", shape, material)
    rng = np.random.default_rng([seed, 1])
    return simulate(scene, [shape], breaker, rng, materials={MATERIAL: material}).recording


def strip(recording: Recording, path: Path, size: tuple[int, int]) -> None:
    """Whole, just broken, opening and falling, side by side."""
    hit = break_frame(recording) or 0
    frames = np.clip(hit + np.rint(np.array(STILLS) / recording.frame_time).astype(int), 0, recording.frames - 1)
    camera = frame_points(_places(recording, frames), size[0] / size[1], azimuth=VIEW)
    renderer = RecordingRenderer(recording, camera, size=size, samples=3, taps=64)
    gap = np.full((size[1], GAP, 3), 255, np.uint8)
    row = [piece for frame in frames for piece in (renderer.picture(int(frame)), gap)][:-1]
    with atomic_file(path) as temporary:
        Image.fromarray(np.concatenate(row, axis=1)).save(temporary, format="PNG", optimize=True)


def _places(recording: Recording, frames: Ints) -> Floats:
    """Where the pot and its pieces are in these frames, shape (n, 3)."""
    there = []
    for track in recording.tracks:
        if track.kind in ("shape", "fragment"):
            poses = [pose(track, int(frame)) for frame in frames if exists(track, int(frame))]
            there += [track.mesh.vertices @ world[:3, :3].T + world[:3, 3] for world in poses]
    return np.concatenate(there)


if __name__ == "__main__":
    import tyro

    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        tyro.cli(slow_motion)
    except BadInput as problem:
        sys.stderr.write(f"04_slow_motion.py: {problem}\n")
        sys.exit(2)
