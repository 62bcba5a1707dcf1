"""Draws the pictures of docs/index.md: shapes, materials and breakers, by our own software renderer.

    python benchmarks/gallery.py            # what is not there yet
    python benchmarks/gallery.py --only bowl-glass --again

Exploded views are of one blow of the learning scene; stills are taken in the world, some hundredths of a second after
the break. The paint is only for looks; what is broken, by what and of what the page says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from contact_sheet import azimuth_of
from harness import DATA, ROOT, exploded_view, shape_named, start, throw
from numpy.typing import NDArray

import deepfracture as df
from deepfracture.recording.motion import break_frame, exists, pose
from deepfracture.render.camera import Camera, frame_points
from deepfracture.render.renderer import RecordingRenderer
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log, track
from deepfracture.types import Appearance, Finish, Floats, Recording, Shape

PAINT = {
    "plaster": (226, 220, 208),
    "ceramic": (189, 94, 61),
    "porcelain": (206, 222, 236),
    "glass": (122, 178, 160),
    "stone": (150, 150, 146),
    "concrete": (128, 132, 138),
}
"""sRGB of the outer surface, by material."""
LYING = ("bunny_oded", "spot", "cheburashka", "squirrel")
"""Files whose y is up."""
HEADING = 200.0
"""Where the balls come from [degrees]."""
QUALITY = 84
"""Of the JPEG files."""


@dataclass(frozen=True)
class Plate:
    """One picture of the gallery."""

    shape: str
    material: str
    breaker: str
    speed: float
    """Of the ball [m/s]."""
    after: float | None = None
    """Still in the world so long after the break [s]; None: an exploded view."""
    number: int = 0
    """Which throw."""
    resolution: int = 128

    @property
    def name(self) -> str:
        view = "exploded" if self.after is None else "flight"
        return f"{self.shape}-{self.material}-{self.breaker}-{view}"


PLATES = (
    Plate("pot", "ceramic", "physical", 60, after=0.07),
    Plate("bunny", "porcelain", "physical", 110),
    Plate("letter_a", "stone", "physical", 16, after=0.16),
    Plate("squirrel", "stone", "physical", 30),
    Plate("mug", "porcelain", "physical", 50, after=0.07),
    Plate("chair", "concrete", "physical", 12, after=0.14),
    Plate("plate", "glass", "physical", 40),
    Plate("spot", "plaster", "physical", 22, after=0.12),
    Plate("base", "plaster", "learned", 20),
    Plate("pot", "plaster", "learned", 24),
    Plate("mug", "plaster", "learned", 12, after=0.10),
    Plate("bowl", "glass", "physical", 45, after=0.06),
    Plate("bunny", "plaster", "voronoi", 14),
    Plate("bunny_oded", "plaster", "cvd", 14, after=0.10, number=1),
    Plate("bar", "concrete", "physical", 14),
    Plate("cheburashka", "ceramic", "physical", 45, after=0.08),
)


def gallery(
    only: tuple[str, ...] = (),
    again: bool = False,
    size: tuple[int, int] = (640, 480),
    resolution: int | None = None,
    data: Path = DATA,
    out: Path = ROOT / "docs" / "images" / "gallery",
) -> list[Path]:
    """Break and draw every plate that is not there yet; returns the paths of those that are.

    Args:
        only: draw plates whose name holds one of these.
        again: draw also what is there.
        size: width and height [pixel].
        resolution: voxels along each axis, in place of each plate's own.
        data: folder of meshes; plates of absent ones are skipped.
        out: folder of the pictures.
    """
    chosen = [plate for plate in PLATES if not only or any(text in plate.name for text in only)]
    if not chosen:
        raise df.BadInput(f"only {', '.join(only)}: no plate has this in its name: {', '.join(p.name for p in PLATES)}")
    done, held = [], []
    for plate in track(chosen, name="plates"):
        path = out / f"{plate.name}.jpg"
        if again or not path.is_file():
            shape = shape_named(plate.shape, data)
            if shape is None:
                continue
            plate = plate if resolution is None else replace(plate, resolution=resolution)
            if not draw(plate, painted(shape, PAINT[plate.material]), size, path):
                held.append(plate.name)
                continue
        done.append(path)
    if held:
        raise df.BadInput(f"{', '.join(held)}: the blow broke nothing; give the plate a faster ball")
    return done


def draw(plate: Plate, shape: Shape, size: tuple[int, int], path: Path) -> bool:
    """Break the shape as the plate says, and keep the picture as a JPEG; False where nothing breaks."""
    breaker = df.breaker(plate.breaker, shape, material=plate.material, resolution=plate.resolution)
    if plate.after is None:
        hit = throw(shape, df.material(plate.material), plate.number, seed=7, speed=(plate.speed, plate.speed + 1))
        fragments = breaker(shape, hit.impact, hit.rng)
        if fragments is None:
            return False
        picture = exploded_view(fragments, shape, size, azimuth=azimuth_of(hit.impact), factor=0.4)
        count = len(fragments)
    else:
        up = "y" if plate.shape in LYING else "z"
        outcome = df.throw(shape, breaker, speed=plate.speed, up=up, seed=plate.number, heading=HEADING)
        if not outcome.breaks:
            return False
        picture = in_flight(outcome.recording, plate.after, size)
        count = sum(len(collision.fragments or ()) for collision in outcome.breaks)
    save_jpeg(picture, path)
    log.warning("%s: %d fragments", plate.name, count)
    return True


def painted(shape: Shape, colour: tuple[int, int, int]) -> Shape:
    """The shape in one colour."""
    return replace(shape, appearance=Appearance(np.zeros(len(shape.mesh.faces), np.int32), (Finish("", colour),)))


def in_flight(recording: Recording, after: float, size: tuple[int, int]) -> NDArray[np.uint8]:
    """The world `after` seconds from the break, from where the ball is seen from its side."""
    frame = min((break_frame(recording) or 0) + round(after / recording.frame_time), recording.frames - 1)
    camera = _camera(recording, frame, size[0] / size[1])
    return RecordingRenderer(recording, camera, size=size, samples=3, taps=64).picture(frame)


def _camera(recording: Recording, frame: int, aspect: float) -> Camera:
    """Sees what is near at this frame: fragments farther out than most may leave the picture."""
    points, start = [], []
    for body in recording.tracks:
        if body.kind == "fragment" and exists(body, frame):
            world = pose(body, frame)
            points.append(body.mesh.vertices @ world[:3, :3].T + world[:3, 3])
        if body.kind == "ball":
            start = [body.positions[0], body.positions[min(5, len(body.positions) - 1)]]
    cloud = np.concatenate(points)
    middle = np.median(cloud, axis=0)
    away = np.linalg.norm(cloud - middle, axis=1)
    near = cloud[away <= max(1.3, 1.15 * float(np.quantile(away, 0.9)))]
    along: Floats = start[1] - start[0]
    return frame_points(near, aspect, azimuth=float(np.degrees(np.arctan2(along[1], along[0]))) - 120)


def save_jpeg(picture: NDArray[np.uint8], path: Path) -> None:
    from PIL import Image

    with atomic_file(path) as temporary:
        Image.fromarray(picture).save(temporary, format="JPEG", quality=QUALITY, optimize=True, progressive=True)


if __name__ == "__main__":
    start(gallery)
