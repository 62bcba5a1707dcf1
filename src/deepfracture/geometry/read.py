"""From a file or a built-in name to a checked Shape."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from deepfracture.geometry.appearance import followed
from deepfracture.geometry.builtin import builtin
from deepfracture.geometry.normalise import normalise
from deepfracture.geometry.orient import oriented
from deepfracture.geometry.soup import Soup, read_scene
from deepfracture.geometry.topology import faults, shell_volumes, shells, split_pinches, weld
from deepfracture.geometry.untangle import crossing_faces
from deepfracture.geometry.wavefront import read_obj
from deepfracture.runtime.progress import log
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import Appearance, BadInput, Mesh, Shape

LONGEST = 1e60
"""Coordinates beyond it, and lengths below its inverse, leave too few powers of ten for volumes squared."""
EXTENSIONS = (".obj", ".stl", ".ply", ".glb", ".gltf", ".off")


def read_triangles(path: str | Path) -> Mesh:
    """Every triangle of a file, scene nodes in place, corners welded; open meshes are allowed.

    Raises BadInput, in one line, for what is not a readable mesh."""
    return _welded(_soup(Path(path)), path)


def _soup(path: Path) -> Soup:
    if not os.path.exists(path):  # also where no file can be called so
        beside = (other.name for other in path.parent.iterdir()) if path.parent.is_dir() else ()
        raise BadInput(f"{path}: no such file{did_you_mean(path.name, beside)}")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder, not a mesh file")
    if path.suffix.lower() not in EXTENSIONS:
        raise BadInput(f"{path}: unknown kind of file {path.suffix!r}; known are {', '.join(EXTENSIONS)}")
    if path.stat().st_size == 0:
        raise BadInput(f"{path}: the file is empty")
    soup = read_obj(path) if path.suffix.lower() == ".obj" else read_scene(path)
    if not len(soup.faces):
        raise BadInput(f"{path}: no triangles found; is it really {_article(path)} file?")
    count = len(soup.vertices)
    if soup.faces.min() < 0 or soup.faces.max() >= count:
        raise BadInput(f"{path}: faces use vertices that the file lacks ({count} given); export it again")
    bad = count - int(np.isfinite(soup.vertices).all(axis=1).sum())
    if bad:
        raise BadInput(f"{path}: {bad} of {count} vertices are NaN or infinite; export it again")
    _check_lengths(soup, path)
    return soup


def _check_lengths(soup: Soup, path: Path) -> None:
    farthest = float(np.abs(soup.vertices).max())
    longest = float(np.ptp(soup.vertices, axis=0).max())
    if farthest > LONGEST:
        raise BadInput(f"{path}: reaches to {farthest:.0e}, past {LONGEST:.0e}; scale it down")
    if 0 < longest < 1 / LONGEST:
        raise BadInput(f"{path}: is {longest:.0e} long, below {1 / LONGEST:.0e}; scale it up")


def _welded(soup: Soup, path: str | Path) -> Mesh:
    try:
        return weld(soup.vertices, soup.faces)
    except BadInput as problem:
        raise BadInput(f"{path}: {problem}") from None


def _article(path: Path) -> str:
    kind = path.suffix[1:].upper()
    return f"{'an' if kind in ('OBJ', 'STL', 'OFF') else 'a'} {kind}"


def check_solid(mesh: Mesh, name: str) -> Mesh:
    """The mesh as the outward-oriented surface of one body, or BadInput with counts and advice.

    Inward shells within the body are cavities. `name` leads the message."""
    found = faults(mesh)
    if found.flipped and not found.boundary and not found.crowded:
        mesh = oriented(mesh)
        found = faults(mesh)
    if not found.closed:
        raise BadInput(f"{name}: {found}; try --repair")
    piece = shells(mesh.faces)
    volumes = shell_volumes(mesh, piece)
    if volumes.sum() < 0:
        # Inside out as a whole: turn it round.
        mesh, volumes = Mesh(mesh.vertices, mesh.faces[:, ::-1]), -volumes
    size = np.ptp(mesh.bounds, axis=0)
    if volumes.sum() <= 1e-9 * size.max() ** 3:
        raise BadInput(
            f"{name}: encloses no volume (box {size[0]:.3g} x {size[1]:.3g} x {size[2]:.3g}); a solid is needed"
        )
    bodies = int((volumes > 0).sum())
    if bodies > 1:
        raise BadInput(
            f"{name}: {bodies} separate closed bodies, one is needed; try --repair if they overlap, else split the file"
        )
    return split_pinches(mesh)


def read_mesh(path: str | Path) -> Mesh:
    """The closed, outward-oriented surface of one body in a file's own coordinates, or BadInput."""
    return check_solid(read_triangles(path), str(path))


def load_shape(path_or_name: str, *, repair: bool = False) -> Shape:
    """A built-in shape by its name, or the shape in a mesh file (OBJ, STL, PLY, GLB, GLTF, OFF) with its looks.

    repair: close what is open, join overlapping shells. Raises BadInput in one line."""
    text = str(path_or_name)
    path = Path(text)
    if not text.strip() or (not path.suffix and not os.path.isfile(path)):
        return builtin(text)
    soup = _soup(path)
    mesh = _welded(soup, path)
    if repair:
        from deepfracture.geometry.repair import repair as repaired

        mesh = repaired(mesh, name=text)
    else:
        mesh = check_solid(mesh, text)
    shape = normalise(mesh, path.stem)
    if not repair:
        _warn_of_crossings(shape, text)
    return replace(shape, appearance=_appearance(soup, mesh, text))


def _warn_of_crossings(shape: Shape, name: str) -> None:
    count = len(crossing_faces(shape.mesh))
    if count:
        log.warning(
            "%s: the surface runs through itself (%d faces): cuts may fail there; --repair mends that",
            name,
            count,
        )


def _appearance(soup: Soup, mesh: Mesh, name: str) -> Appearance | None:
    """What the file says of the looks of the mesh that was made of it, None if it says nothing."""
    try:
        given = soup.appearance()
    except BadInput as problem:
        raise BadInput(f"{name}: {problem}; export it again") from None
    if given is None:
        return None
    appearance, new = followed(given, Mesh(soup.vertices, soup.faces), mesh)
    if new:
        log.info("%s: %d of %d faces are new and look like what is nearest to them", name, new, len(mesh.faces))
    return appearance
