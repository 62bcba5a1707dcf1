"""Pictures and other files that a mesh file names: read from its own folder only, and only if they are sound."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from deepfracture.runtime.progress import log

if TYPE_CHECKING:
    from trimesh.resolvers import Resolver

MAX_BYTES = 1 << 28
"""Bytes of a file beside a mesh that are read at most."""
FORMATS = ("PNG", "JPEG", "BMP", "TGA", "WEBP")
GLTF_FORMATS = ("PNG", "JPEG")
"""What glTF allows; the rest becomes PNG."""


def read_sibling(path: Path, name: str) -> bytes | None:
    """What is in the file `name`, relative to the mesh file `path`.

    None, and one line in the log, if it is missing, too large, or anywhere but in the mesh's folder, links followed."""
    folder = path.parent.resolve()
    try:
        file = (folder / name.replace("\\", "/")).resolve()
        if not file.is_relative_to(folder):
            log.warning("%s: names %s, which lies outside its folder and is not read", path, name[:80])
        elif not file.is_file():
            log.warning("%s: names %s, which is missing; its look is lost", path, name[:80])
        elif file.stat().st_size > MAX_BYTES:
            log.warning("%s: names %s, which is larger than %d MB and is not read", path, name[:80], MAX_BYTES >> 20)
        else:
            return file.read_bytes()
    except (OSError, ValueError, RuntimeError) as problem:  # names too long, with a zero byte, links in a ring
        reason = getattr(problem, "strerror", None) or type(problem).__name__
        log.warning("%s: names %s, which cannot be read (%s)", path, name[:80].replace("\0", "?"), reason)
    return None


def texture(path: Path, name: str) -> bytes | None:
    """The picture `name` beside the mesh file `path` as PNG or JPEG; None, and a line in the log, without it."""
    data = read_sibling(path, name)
    return None if data is None else to_texture(data, f"{path}: {name[:80]}")


def to_texture(data: bytes, name: str) -> bytes | None:
    """A picture's bytes as PNG or JPEG; None, and one line in the log that begins with `name`, if it is not sound."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as image:
            image.load()  # a picture that breaks off is found here, not in the user's viewer
            if image.format in GLTF_FORMATS:
                return data
            png = io.BytesIO()
            image.convert("RGBA").save(png, format="PNG")
            return png.getvalue()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as problem:
        reason = (str(problem).splitlines() or [type(problem).__name__])[0]
        log.warning("%s: not a picture that can be used as a texture (%s)", name, reason[:100])
        return None


def folder_resolver(path: Path) -> Resolver:
    """trimesh's way to the files that the mesh file `path` names: those in its own folder."""
    from trimesh.resolvers import Resolver

    class Beside(Resolver):
        def __init__(self) -> None: ...

        def get(self, key: str) -> bytes:
            data = read_sibling(path, unquote(key))
            if data is None:
                raise FileNotFoundError(key)
            return data

        def write(self, name: str, data: str | bytes) -> None:
            raise PermissionError(name)

        def namespaced(self, namespace: str) -> Resolver:
            return self

        def keys(self) -> list[str]:
            return []

    return Beside()
