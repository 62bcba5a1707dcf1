"""What `shatter` can write, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from deepfracture.export import write_fragments, write_glb, write_sequence, write_usd
from deepfracture.render import before_hit_after, write_film
from deepfracture.runtime.extras import require, skip_unless_installed
from deepfracture.runtime.progress import stage
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput
from deepfracture.viewer import write_page
from deepfracture.world import Outcome, Scene


@dataclass(frozen=True)
class Format:
    """One kind of result: a file or a folder."""

    file: str
    write: Callable[[Outcome, Scene, Path], list[str] | None]
    """What it returns are the names of what it wrote, if those are others than `file`."""
    library: str = ""
    """What it needs that not everybody installs ..."""
    extra: str = ""
    """... and the extra of this program that brings it."""


def _usd(outcome: Outcome, scene: Scene, path: Path) -> None:
    write_usd(outcome.recording, path, gravity=scene.gravity, contact_material=scene.contact_material)


def _film(outcome: Outcome, scene: Scene, path: Path) -> None:
    write_film(outcome.recording, path)


def _frames(kind: str) -> Callable[[Outcome, Scene, Path], None]:
    def write(outcome: Outcome, scene: Scene, path: Path) -> None:
        write_sequence(outcome.recording, path, kind=kind)

    return write


FORMATS: dict[str, Format] = {
    "page": Format("animation.html", lambda outcome, _, path: write_page(outcome.recording, path), "viser", "play"),
    "glb": Format("animation.glb", lambda outcome, _, path: write_glb(outcome.recording, path)),
    "picture": Format("picture.png", lambda outcome, _, path: before_hit_after(outcome.recording, path)),
    "film": Format("animation.mp4", _film, "imageio_ffmpeg", "render"),
    "fragments": Format("fragments", lambda outcome, _, path: _fragments(outcome, path)),
    "usd": Format("animation.usdc", _usd, "pxr", "usd"),
    "usda": Format("animation.usda", _usd, "pxr", "usd"),
    "usdz": Format("animation.usdz", _usd, "pxr", "usd"),
    "obj-sequence": Format("obj_sequence", _frames("obj")),
    "ply-sequence": Format("ply_sequence", _frames("ply")),
}
USUAL = ("page", "glb", "picture", "film", "fragments")
"""What is written if nobody says: of these, those whose library is there."""


def check_formats(names: Sequence[str]) -> None:
    """Raise BadInput, before any work is done, for a format that is unknown or whose library is missing."""
    for name in names:
        if name not in FORMATS:
            raise BadInput(f"--formats must be some of {', '.join(FORMATS)}, got {name!r}{did_you_mean(name, FORMATS)}")
        wanted = FORMATS[name]
        if wanted.library:
            require(wanted.library, extra=wanted.extra, to=f"write {wanted.file}")


def write_formats(
    outcome: Outcome, scene: Scene, out: Path, names: Sequence[str] | None, *, film: bool = True
) -> list[str]:
    """Write `names`, or the usual, into the folder `out`; returns the files and folders that are there now.

    film: False leaves that out."""
    files = []
    for name in dict.fromkeys(USUAL if names is None else names):
        wanted = FORMATS[name]
        if name == "film" and not film:
            continue
        if names is None and wanted.library and skip_unless_installed(wanted.file, wanted.library, extra=wanted.extra):
            continue
        with stage(f"write {wanted.file}"):
            files += wanted.write(outcome, scene, out / wanted.file) or [wanted.file]
    return files


def _fragments(outcome: Outcome, path: Path) -> list[str]:
    """A folder for each break, numbered if there are several; returns their names."""
    folders = []
    for number, collision in enumerate(outcome.breaks):
        folder = path.name if len(outcome.breaks) == 1 else f"{path.name}_{number}"
        assert collision.fragments is not None
        write_fragments(collision.fragments, collision.shape, path.with_name(folder))
        folders.append(folder)
    return folders
