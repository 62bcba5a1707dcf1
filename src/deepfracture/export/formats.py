"""What results are written as: one entry a format, for `save` and for `shatter --formats` alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from deepfracture.export.gltf import write_glb
from deepfracture.export.meshes import write_fragments
from deepfracture.export.page import write_page
from deepfracture.export.sequence import write_sequence
from deepfracture.export.usd import write_usd
from deepfracture.render import before_hit_after, exploded, write_film
from deepfracture.runtime.extras import require, skip_unless_installed
from deepfracture.runtime.progress import stage
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Fragments, Recording, Shape


@dataclass(frozen=True)
class Format:
    """A file or folder, and what writes it."""

    file: str
    """Its name in the folder of `shatter`; `save` goes by the suffix, of several formats with the same to the first."""
    write: Callable[..., object]
    """(recording, path, **options), or (fragments, path, shape=..., **options)."""
    source: type = Recording
    """What it shows: a `Recording`, or the `Fragments` of one break."""
    library: str = ""
    """Optional library that it needs ..."""
    extra: str = ""
    """... and the extra of this program that installs it."""
    suffixes: tuple[str, ...] = ()
    """Other suffixes that `save` takes for it."""


def _meshes(fragments: Fragments, path: Path, *, shape: Shape) -> None:
    write_fragments(fragments, shape, path)


FORMATS = {
    "glb": Format("animation.glb", write_glb),
    "page": Format("animation.html", write_page, library="viser", extra="play"),
    "picture": Format("picture.png", before_hit_after),
    "film": Format("animation.mp4", write_film, library="imageio_ffmpeg", extra="render"),
    "fragments": Format("fragments", _meshes, Fragments),
    "exploded": Format("exploded.png", exploded, Fragments),
    "usd": Format("animation.usdc", write_usd, library="pxr", extra="usd", suffixes=(".usd",)),
    "usda": Format("animation.usda", write_usd, library="pxr", extra="usd"),
    "usdz": Format("animation.usdz", write_usd, library="pxr", extra="usd"),
    "obj-sequence": Format("obj_sequence", partial(write_sequence, kind="obj")),
    "ply-sequence": Format("ply_sequence", partial(write_sequence, kind="ply")),
}
DEFAULT = ("page", "glb", "picture", "film", "fragments")
"""What `shatter` writes unless told otherwise, as far as the libraries are installed."""


def format_for(path: Path, source: type) -> Format:
    """The format that the suffix of `path` stands for.

    Raises:
        BadInput: No format of `source` has that suffix.
    """
    known: dict[str, Format] = {}
    for format in FORMATS.values():
        for suffix in (Path(format.file).suffix, *format.suffixes):
            if format.source is source:
                known.setdefault(suffix, format)
    if path.suffix.lower() not in known:
        names = ", ".join(suffix or "a folder (no suffix)" for suffix in known)
        raise BadInput(f"{path}: {source.__name__.lower()} can be saved as {names}, not as {path.suffix or 'a folder'}")
    return known[path.suffix.lower()]


def check_formats(names: Sequence[str]) -> None:
    """Raise BadInput, before any work is done, for a format that is unknown or whose library is missing."""
    for name in names:
        if name not in FORMATS:
            raise BadInput(f"--formats must be some of {', '.join(FORMATS)}, got {name!r}{did_you_mean(name, FORMATS)}")
        wanted = FORMATS[name]
        if wanted.library:
            require(wanted.library, extra=wanted.extra, to=f"write {wanted.file}")


def write_formats(
    recording: Recording,
    breaks: Sequence[tuple[Fragments, Shape]],
    out: Path,
    names: Sequence[str] | None,
    *,
    film: bool = True,
    **physics: Any,
) -> list[str]:
    """Write `names`, or the default formats, into the folder `out`; returns the files and folders written.

    Args:
        recording: What the world did.
        breaks: The fragments of each break, with the shape that they are of; the files are numbered if there are
            several.
        film: False leaves that one out.
        physics: gravity and contact_material of the scene, which USD keeps.
    """
    files = []
    for name in dict.fromkeys(DEFAULT if names is None else names):
        wanted = FORMATS[name]
        if name == "film" and not film:
            continue
        if names is None and wanted.library and skip_unless_installed(wanted.file, wanted.library, extra=wanted.extra):
            continue
        with stage(f"write {wanted.file}"):
            if wanted.source is Recording:
                wanted.write(recording, out / wanted.file, **(physics if wanted.write is write_usd else {}))
                files.append(wanted.file)
                continue
            for number, (fragments, shape) in enumerate(breaks):
                path = out / wanted.file
                path = path if len(breaks) == 1 else path.with_stem(f"{path.stem}_{number}")
                wanted.write(fragments, path, shape=shape)
                files.append(path.name)
    return files
