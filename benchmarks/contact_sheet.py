"""Draws docs/images/contact_sheet.png: five hits on each of several shapes, beside FractureRB's.

Every hit is simulated once and kept, its picture and its figures, in the folder --out; run again to go on, and use
another folder once the simulator has changed. The balls of a row come faster and faster, one speed drawn from each
fifth of the range; the caption's is the closing speed along the normal.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from harness import DATA, REFERENCE, ROOT, SPEEDS, kept, shape_named, start, throw

from deepfracture.carve import cut
from deepfracture.fracture import FractureBody, material, prepare_body, simulate
from deepfracture.geometry import mass_properties
from deepfracture.render.picture import exploded
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log, track
from deepfracture.types import BadInput, Fragment, Fragments, Grid, Impact, Shape

if TYPE_CHECKING:
    from PIL import Image

SHAPES = ("squirrel", "pot", "bunny", "bar", "plate", "mug")
MOST_BYTES = 1_500_000
"""A larger PNG is written with fewer colours."""
COLOURS = (256, 128, 64, 32)
CAPTION = 34
"""Height of a picture's caption [pixel]."""
INK = (40, 40, 40)
PAPER = (255, 255, 255)
SIDE = 35.0
"""Degrees by which the camera stands beside the direction of the hit: the hit and the depth of the cracks show."""


def contact_sheet(
    shapes: tuple[str, ...] = SHAPES,
    hits: int = 5,
    resolution: int = 128,
    preset: str = "plaster",
    speed: tuple[float, float] = SPEEDS,
    size: tuple[int, int] = (300, 260),
    factor: float = 0.35,
    seed: int = 0,
    data: Path = DATA,
    reference: Path = REFERENCE,
    out: Path = ROOT / "runs" / "contact_sheet",
    sheet: Path = ROOT / "docs" / "images" / "contact_sheet.png",
) -> Path:
    """Simulate random hits on each shape and put their exploded pictures on one sheet.

    Args:
        shapes: built-in names, or names of .obj files in --data; absent ones are skipped.
        hits: per shape.
        resolution: voxels along each axis.
        preset: the whole-material preset.
        speed: slowest and fastest ball [m/s].
        size: width and height of one picture [pixel].
        factor: how far fragments move outwards, as a share of their distance from the middle.
        seed: of the hits and the material.
        data: folder of meshes.
        reference: folder with fracturerb_SHAPE.png, shown as the last column.
        out: folder where finished pictures and figures are kept.
        sheet: the PNG to write, at most 1.5 MB.
    """
    if hits < 1:
        raise BadInput(f"hits must be at least 1, got {hits}")
    found = [shape for shape in (shape_named(name, data) for name in shapes) if shape is not None]
    bodies: dict[str, FractureBody] = {}
    cells: dict[str, list[tuple[Path, str]]] = {shape.name: [] for shape in found}
    todo = [(shape, number) for shape in found for number in range(hits)]
    edges = np.linspace(*speed, hits + 1)
    for shape, number in track(todo, name="hits"):
        key = f"{shape.name}-{preset}-r{resolution}-{speed[0]:g}-{speed[1]:g}-{number}of{hits}-s{seed}"
        picture = out / f"{key}.png"

        def render(shape: Shape = shape, number: int = number, picture: Path = picture) -> dict[str, Any]:
            if shape.name not in bodies:
                bodies.clear()  # one at a time is enough: they come in order
                bodies[shape.name] = prepare_body(shape, material(preset), Grid(resolution))
            band = (float(edges[number]), float(edges[number + 1]))
            return _hit(bodies[shape.name], number, seed, band, picture, size, factor)

        cells[shape.name].append((picture, _caption(kept(out / f"{key}.json", render))))
    for name, row in cells.items():
        if (reference / f"fracturerb_{name}.png").is_file():
            row.append((reference / f"fracturerb_{name}.png", f"{name}: FractureRB"))
    save(grid_of(list(cells.values()), size), sheet)
    log.warning("%s: %.2f MB", sheet.name, sheet.stat().st_size / 1e6)
    return sheet


def _hit(
    body: FractureBody, number: int, seed: int, speed: tuple[float, float], picture: Path, size: tuple[int, int],
    factor: float,
) -> dict[str, Any]:  # fmt: skip
    """Simulate one hit, write its picture, return its figures."""
    shape, stuff = body.shape, body.material
    hit = throw(shape, stuff, number, seed=seed, speed=speed)
    begin = time.perf_counter()
    cracking = simulate(body, hit.impact, hit.rng)
    seconds = time.perf_counter() - begin
    pieces = _whole(shape, stuff.density) if cracking is None else cut(shape, cracking.pattern, density=stuff.density)
    exploded(pieces, picture, factor=factor, size=size, azimuth=azimuth_of(hit.impact))
    volumes = sorted((piece.volume for piece in pieces), reverse=True)
    return {
        "shape": shape.name,
        "seed": hit.seed,
        "impulse": float(hit.impact.magnitude[0]),
        "speed": hit.impact.speed,
        "position": hit.impact.position[0],
        "cracks": 0 if cracking is None else cracking.cracks,
        "fragments": len(pieces),
        "largest_share": volumes[0] / sum(volumes),
        "volumes": volumes,
        "seconds": seconds,
    }


def _whole(shape: Shape, density: float) -> Fragments:
    mass = mass_properties(shape.mesh, density)
    source = np.arange(len(shape.mesh.faces))
    return Fragments((Fragment(shape.mesh, source, mass.mass, mass.centre, mass.inertia),))


def azimuth_of(impact: Impact) -> float:
    """Where to stand to see the place that was hit [degrees]."""
    x, y, _ = impact.position[0] if np.linalg.norm(impact.position[0][:2]) > 0.3 else impact.normal[0]
    return float(np.degrees(np.arctan2(y, x))) + SIDE


def _caption(about: dict[str, Any]) -> str:
    pieces = f"{about['fragments']} fragments" if about["fragments"] > 1 else "unbroken"
    first = f"{about['shape']}  {about['impulse']:.0f} N s at {about['speed']:.1f} m/s"
    return f"{first}\n{pieces}, {about['cracks']} cracks, {about['seconds']:.1f} s"


def grid_of(rows: list[list[tuple[Path, str]]], size: tuple[int, int]) -> Image.Image:
    from PIL import Image, ImageDraw

    (width, height), columns = size, max(len(row) for row in rows)
    sheet = Image.new("RGB", (columns * width, len(rows) * (height + CAPTION)), PAPER)
    draw = ImageDraw.Draw(sheet)
    for y, row in enumerate(rows):
        for x, (path, caption) in enumerate(row):
            left, top = x * width, y * (height + CAPTION)
            with Image.open(path) as opened:
                picture = opened.convert("RGB")
            picture.thumbnail(size, Image.Resampling.LANCZOS)
            sheet.paste(picture, (left + (width - picture.width) // 2, top + (height - picture.height) // 2))
            draw.multiline_text((left + 8, top + height + 3), caption, fill=INK, font_size=12)
    return sheet


def save(sheet: Image.Image, path: Path) -> None:
    """A PNG below `MOST_BYTES`: with as many colours as fit."""
    with atomic_file(path) as temporary:
        sheet.save(temporary, format="PNG", optimize=True)
        for colours in COLOURS:
            if temporary.stat().st_size <= MOST_BYTES:
                return
            sheet.quantize(colours).save(temporary, format="PNG", optimize=True)
        if temporary.stat().st_size > MOST_BYTES:
            raise BadInput(f"{path}: the sheet is larger than {MOST_BYTES} bytes; use smaller pictures (--size)")


if __name__ == "__main__":
    start(contact_sheet)
