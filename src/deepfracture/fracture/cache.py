"""Factorised boundary-element systems on disk: the factor belongs to the shape, not to the collision."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np

from deepfracture.geometry import remesh
from deepfracture.progress import log
from deepfracture.types import BadInput, Mesh

from .elastostatics import ElasticBody, prepare

VERSION = 1
"""Changes when the same mesh would be remeshed or factorised to something else."""
KEPT = 6
"""Bodies kept, the last used ones; each takes some 120 MB."""


def cache_folder() -> Path:
    """Where bodies are kept: $XDG_CACHE_HOME/deepfracture, or ~/.cache/deepfracture."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "deepfracture"


def elastic_body(mesh: Mesh, poisson: float, elements: int) -> ElasticBody:
    """The elastic body of a mesh with about `elements` triangles, from the cache where it is there."""
    digest = hashlib.sha256(np.ascontiguousarray(mesh.vertices).tobytes() + mesh.faces.tobytes())
    digest.update(f"{poisson!r} {elements} {VERSION}".encode())
    path = cache_folder() / f"{digest.hexdigest()[:32]}.elastic"
    if path.exists():
        try:
            body = ElasticBody.load(path)
        except BadInput as damaged:
            log.warning("%s; it is made anew", damaged)
        else:
            os.utime(path)
            return body
    body = prepare(remesh(mesh, elements), poisson)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        body.save(path)
        _prune(path.parent)
    except OSError as error:  # a full or read-only disk costs time, not the result
        log.warning("%s: cannot keep the prepared body (%s)", path.parent, error.strerror)
    return body


def _prune(folder: Path) -> None:
    bodies = sorted(folder.glob("*.elastic"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in bodies[KEPT:]:
        path.unlink(missing_ok=True)
