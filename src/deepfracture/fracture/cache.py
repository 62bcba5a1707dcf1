"""Disk cache of prepared shapes: factorised boundary-element systems and distance fields."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from deepfracture.fracture.elastostatics import ElasticBody, prepare
from deepfracture.fracture.padded_grid import PaddedGrid
from deepfracture.geometry import remesh, signed_distance_lattice
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log, stage
from deepfracture.types import BadInput, Floats32, Mesh

VERSION = 2
"""Increased when the remeshing, the factorisation or the distances of the same mesh change."""
MAX_FILES = 6
"""Most recently used files kept of each kind: a body takes some 120 MB, its distances at r = 128 10 MB."""

T = TypeVar("T")


def cache_folder() -> Path:
    """$XDG_CACHE_HOME/deepfracture, or ~/.cache/deepfracture."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "deepfracture"


def cached_elastic_body(mesh: Mesh, poisson: float, elements: int, *, cache: bool = True) -> ElasticBody:
    """The elastic body of a mesh with about `elements` triangles, from the cache if possible.

    Without `cache` it is neither read nor written."""

    def make() -> ElasticBody:
        with stage("remesh"):
            coarse = remesh(mesh, elements)
        with stage("boundary elements"):
            return prepare(coarse, poisson)

    if not cache:
        return make()
    return _cached(
        _path(mesh, f"{poisson!r} {elements} {VERSION}", "elastic"), ElasticBody.load, ElasticBody.save, make
    )


def cached_distances(mesh: Mesh, grid: PaddedGrid, *, outside: float, cache: bool = True) -> Floats32:
    """Signed distance to the surface at the cells of `grid` [m], positive inside, from the cache if possible.

    Distances outside the body are truncated at `outside` [m], which saves most of the work.
    Without `cache` it is neither read nor written."""

    def make() -> Floats32:
        corner = np.full(3, grid.first_centre)
        with stage("distances"):
            return signed_distance_lattice(mesh, corner, grid.spacing, grid.shape, outside=outside)

    if not cache:
        return make()
    return _cached(_path(mesh, f"{grid} {outside!r} {VERSION}", "distances"), _load_array, _save_array, make)


def _load_array(path: Path) -> Floats32:
    try:
        # A memory map fails if the file is shorter than its header claims; `np.load` would allocate first.
        return np.array(np.lib.format.open_memmap(path, mode="r"))
    except FileNotFoundError:
        raise
    except Exception as error:  # numpy raises errors of many kinds on damaged files
        raise BadInput(f"{path}: not a saved distance field ({type(error).__name__})") from error


def _save_array(values: Floats32, path: Path) -> None:
    with atomic_file(path) as temporary, open(temporary, "wb") as file:
        np.save(file, values)


def _path(mesh: Mesh, what: str, kind: str) -> Path:
    digest = hashlib.sha256(np.ascontiguousarray(mesh.vertices).tobytes() + mesh.faces.tobytes())
    digest.update(what.encode())
    return cache_folder() / f"{digest.hexdigest()[:32]}.{kind}"


def _cached(path: Path, load: Callable[[Path], T], save: Callable[[T, Path], None], make: Callable[[], T]) -> T:
    """The object stored at `path`, or else the one that `make` builds, which is then stored there."""
    try:
        found = load(path)
        os.utime(path)
        return found
    except FileNotFoundError:
        pass  # not cached, or pruned by another process
    except BadInput as damaged:
        log.warning("%s; rebuilding it", damaged)
    built = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save(built, path)
        _prune(path.parent, path.suffix)
    except OSError as error:  # a full or read-only disk costs time, not the result
        log.warning("%s: cannot cache the prepared body (%s)", path.parent, error.strerror)
    return built


def _prune(folder: Path, suffix: str) -> None:
    files = sorted(folder.glob(f"*{suffix}"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files[MAX_FILES:]:
        path.unlink(missing_ok=True)
