"""What is worked out once a shape, kept on disk: factorised boundary-element systems and distance lattices."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from deepfracture.fracture.elastostatics import ElasticBody, prepare
from deepfracture.fracture.lattice import Lattice
from deepfracture.geometry import remesh, signed_distance_lattice
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log, stage
from deepfracture.types import BadInput, Floats32, Mesh

VERSION = 2
"""Changes when the same mesh would be remeshed or factorised to something else, or its distances change."""
KEPT = 6
"""Files kept of each kind, the last used ones: a body takes some 120 MB, its distances at r = 128 10 MB."""

T = TypeVar("T")


def cache_folder() -> Path:
    """Where bodies are kept: $XDG_CACHE_HOME/deepfracture, or ~/.cache/deepfracture."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "deepfracture"


def elastic_body(mesh: Mesh, poisson: float, elements: int, *, keep: bool = True) -> ElasticBody:
    """The elastic body of a mesh with about `elements` triangles, from the cache where it is there.

    Unless `keep`, the cache is neither read nor written."""

    def make() -> ElasticBody:
        with stage("remesh"):
            coarse = remesh(mesh, elements)
        with stage("boundary elements"):
            return prepare(coarse, poisson)

    if not keep:
        return make()
    return _kept(_path(mesh, f"{poisson!r} {elements} {VERSION}", "elastic"), ElasticBody.load, ElasticBody.save, make)


def distances(mesh: Mesh, lattice: Lattice, *, outside: float, keep: bool = True) -> Floats32:
    """Distance to the surface at the cells of `lattice` [m], positive inside, from the cache where it is there.

    Outside the body distances above `outside` [m] are cut off at it: that spares most of the work.
    Unless `keep`, the cache is neither read nor written."""

    def make() -> Floats32:
        corner = np.full(3, lattice.first_centre)
        with stage("distances"):
            return signed_distance_lattice(mesh, corner, lattice.spacing, lattice.shape, outside=outside)

    if not keep:
        return make()
    return _kept(_path(mesh, f"{lattice} {outside!r} {VERSION}", "distances"), _load_array, _save_array, make)


def _load_array(path: Path) -> Floats32:
    try:
        # A map is refused where the file is shorter than its head says; `np.load` would take that memory first.
        return np.array(np.lib.format.open_memmap(path, mode="r"))
    except FileNotFoundError:
        raise
    except Exception as error:  # numpy raises errors of many kinds on damaged files
        raise BadInput(f"{path}: not a saved distance lattice ({type(error).__name__})") from error


def _save_array(values: Floats32, path: Path) -> None:
    with atomic_file(path) as temporary, open(temporary, "wb") as file:
        np.save(file, values)


def _path(mesh: Mesh, what: str, kind: str) -> Path:
    digest = hashlib.sha256(np.ascontiguousarray(mesh.vertices).tobytes() + mesh.faces.tobytes())
    digest.update(what.encode())
    return cache_folder() / f"{digest.hexdigest()[:32]}.{kind}"


def _kept(path: Path, load: Callable[[Path], T], save: Callable[[T, Path], None], make: Callable[[], T]) -> T:
    """What `path` keeps, or what `make` makes: that is kept there for the next time."""
    try:
        kept = load(path)
        os.utime(path)
        return kept
    except FileNotFoundError:
        pass  # never made, or another process has just made room
    except BadInput as damaged:
        log.warning("%s; it is made anew", damaged)
    made = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save(made, path)
        _prune(path.parent, path.suffix)
    except OSError as error:  # a full or read-only disk costs time, not the result
        log.warning("%s: cannot keep the prepared body (%s)", path.parent, error.strerror)
    return made


def _prune(folder: Path, suffix: str) -> None:
    files = sorted(folder.glob(f"*{suffix}"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files[KEPT:]:
        path.unlink(missing_ok=True)
