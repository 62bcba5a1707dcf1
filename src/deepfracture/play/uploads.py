"""Meshes that players upload."""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deepfracture.geometry import load_shape
from deepfracture.play.library import UP_AXIS, Entry
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Shape

UPLOAD_SUFFIXES = (".obj", ".stl", ".ply", ".glb")
"""Files that can be uploaded."""
MAX_FACES = 500_000
"""Triangles of an uploaded mesh."""


def read_upload(content: bytes, name: str, folder: Path, *, limit: int) -> Entry:
    """An uploaded mesh, repaired where necessary. Of `name` only the suffix and the label are used.

    The file is written to the new `folder` under a fixed name. `limit`: maximum size [bytes]. BadInput names the file
    as the player does."""
    label, kind = _label(name), Path(name).suffix.lower()
    if kind not in UPLOAD_SUFFIXES:
        raise BadInput(f"{label}: unknown kind of file; drop one of {', '.join(UPLOAD_SUFFIXES)}")
    if len(content) > limit:
        raise BadInput(too_large(label, len(content), limit))
    folder.mkdir(parents=True)
    path = folder / f"mesh{kind}"
    path.write_bytes(content)
    try:
        shape, repairs = _load_repaired(path)
    except BadInput as problem:
        raise BadInput(str(problem).replace(str(path), label).replace("; try --repair", "")) from None
    if len(shape.mesh.faces) > MAX_FACES:
        raise BadInput(f"{label}: {len(shape.mesh.faces):,} triangles; decimate it to {MAX_FACES:,} or fewer")
    return Entry(label, shape, str(path), UP_AXIS.get(kind, "z"), bool(repairs), repairs.replace(str(path), label))


def too_large(label: str, size: int, limit: int) -> str:
    """The message about a file above the limit [bytes]."""
    return (
        f"{label}: {size / 1e6:.0f} MB; at most {limit / 1e6:.0f} MB can be uploaded (deepfracture play --upload-limit)"
    )


def _label(name: str) -> str:
    """Name of a file on the page: the last part of its path, plain characters only, at most 40."""
    last = re.split(r"[/\\]", name)[-1]
    return re.sub(r"[^\w .()-]", "_", last, flags=re.ASCII)[-40:] or "file"


def _load_repaired(path: Path) -> tuple[Shape, str]:
    """The shape in a file, and what was repaired, "" if nothing."""
    try:
        return load_shape(str(path)), ""
    except BadInput as problem:
        with _captured_warnings() as warnings:
            shape = load_shape(str(path), repair=True)
        return shape, warnings[-1] if warnings else str(problem)


@contextmanager
def _captured_warnings() -> Iterator[list[str]]:
    """Log warnings of this thread, which are kept from the terminal."""
    messages: list[str] = []
    thread = threading.get_ident()

    class Capture(logging.Filter):
        def filter(self, record: logging.LogRecord) -> bool:
            if record.thread != thread:
                return True
            if record.levelno >= logging.WARNING:
                messages.append(record.getMessage())
            return False

    capture = Capture()
    log.addFilter(capture)
    try:
        yield messages
    finally:
        log.removeFilter(capture)
