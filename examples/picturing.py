"""Pictures side by side, with a line below each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from deepfracture.render import exploded
from deepfracture.runtime.files import atomic_file
from deepfracture.types import Fragments, Shape

INK, PAPER = (40, 40, 40), (255, 255, 255)
LINE = 24
"""Height of a caption [pixel]."""
GAP = 4


def exploded_view(
    fragments: Fragments, shape: Shape, size: tuple[int, int], *, factor: float = 0.4, **view: float
) -> NDArray[np.uint8]:
    """RGB (h, w, 3) of the fragments, moved apart, seen from `azimuth` and `elevation` [degrees]."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "view.png"
        exploded(fragments, path, shape=shape, size=size, factor=factor, **view)
        with Image.open(path) as picture:
            return np.asarray(picture.convert("RGB"))


def panel(views: Sequence[tuple[NDArray[np.uint8], str]], path: Path, *, columns: int = 4) -> None:
    """Write pictures of one size, each with its caption, in rows of so many."""
    height, width = views[0][0].shape[:2]
    columns = min(columns, len(views))
    rows = -(-len(views) // columns)
    sheet = Image.new("RGB", (columns * (width + GAP) - GAP, rows * (height + LINE)), PAPER)
    draw = ImageDraw.Draw(sheet)
    for k, (picture, caption) in enumerate(views):
        left, top = k % columns * (width + GAP), k // columns * (height + LINE)
        sheet.paste(Image.fromarray(picture), (left, top))
        draw.text((left + 8, top + height + 5), caption, fill=INK, font_size=13)
    with atomic_file(path) as temporary:
        sheet.save(temporary, format="PNG", optimize=True)
