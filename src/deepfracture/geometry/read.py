"""Mesh files as checked triangles and solids."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from deepfracture.geometry.orient import orient
from deepfracture.geometry.soup import TriangleSoup, read_scene
from deepfracture.geometry.topology import mesh_defects, shell_volumes, shells, split_pinches, weld
from deepfracture.geometry.wavefront import read_obj
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Mesh

MAX_COORDINATE = 1e60
"""Coordinates beyond it, and lengths below its inverse, leave too few powers of ten for volumes squared."""
EXTENSIONS = (".obj", ".stl", ".ply", ".glb", ".gltf", ".off")


def read_triangles(path: str | Path) -> Mesh:
    """Every triangle of a file, scene nodes in place, corners welded; open meshes are allowed.

    Raises BadInput, in one line, for what is not a readable mesh."""
    return weld_soup(read_soup(Path(path)), path)


def read_soup(path: Path) -> TriangleSoup:
    """The triangles of a file as written there. Raises BadInput as `read_triangles` does."""
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


def _check_lengths(soup: TriangleSoup, path: Path) -> None:
    farthest = float(np.abs(soup.vertices).max())
    longest = float(np.ptp(soup.vertices, axis=0).max())
    if farthest > MAX_COORDINATE:
        raise BadInput(f"{path}: reaches to {farthest:.0e}, past {MAX_COORDINATE:.0e}; scale it down")
    if 0 < longest < 1 / MAX_COORDINATE:
        raise BadInput(f"{path}: is {longest:.0e} long, below {1 / MAX_COORDINATE:.0e}; scale it up")


def weld_soup(soup: TriangleSoup, path: str | Path) -> Mesh:
    """The soup's triangles with shared vertices. Raises BadInput, which `path` leads."""
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
    found = mesh_defects(mesh)
    if found.flipped and not found.boundary and not found.non_manifold:
        mesh = orient(mesh)
        found = mesh_defects(mesh)
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
