"""From a file or a built-in name to a checked Shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepfracture.geometry.builtin import builtin
from deepfracture.geometry.normalise import normalise
from deepfracture.geometry.orient import oriented
from deepfracture.geometry.topology import faults, shell_volumes, shells, split_pinches, weld
from deepfracture.types import BadInput, Mesh, Shape

EXTENSIONS = (".obj", ".stl", ".ply", ".glb", ".gltf", ".off")


def read_triangles(path: str | Path) -> Mesh:
    """Every triangle of a file, scene nodes in place, corners welded; open meshes are allowed.

    Raises BadInput, in one line, for what is not a readable mesh."""
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: no such file")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder, not a mesh file")
    if path.suffix.lower() not in EXTENSIONS:
        raise BadInput(f"{path}: unknown kind of file {path.suffix!r}; known are {', '.join(EXTENSIONS)}")
    if path.stat().st_size == 0:
        raise BadInput(f"{path}: the file is empty")
    vertices, faces = _parse(path)
    if not len(faces):
        raise BadInput(f"{path}: no triangles found; is it really {_article(path)} file?")
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise BadInput(f"{path}: {bad.sum()} of {len(vertices)} vertices are NaN or infinite; export it again")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise BadInput(f"{path}: faces use vertices that the file lacks ({len(vertices)} given); export it again")
    try:
        return weld(vertices, faces)
    except BadInput as problem:
        raise BadInput(f"{path}: {problem}") from None


def _article(path: Path) -> str:
    kind = path.suffix[1:].upper()
    return f"{'an' if kind in ('OBJ', 'STL', 'OFF') else 'a'} {kind}"


def _parse(path: Path) -> tuple[np.ndarray, np.ndarray]:
    import logging

    import trimesh

    # trimesh reports what it skips to its own logger; our one line says enough.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        mesh = trimesh.load_scene(path, process=False, skip_materials=True).to_mesh()
        vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
    except Exception as problem:  # Loaders raise anything on garbage; every case is the same to the user.
        reason = (str(problem).strip().splitlines() or [type(problem).__name__])[0]
        raise BadInput(f"{path}: not a readable {path.suffix[1:].upper()} file ({reason})") from None
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


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
    """A built-in shape by its name, or the shape in a mesh file (OBJ, STL, PLY, GLB, GLTF, OFF).

    repair: close what is open, join overlapping shells. Raises BadInput in one line."""
    text = str(path_or_name)
    path = Path(text)
    if not text.strip() or (not path.suffix and not path.is_file()):
        return builtin(text)
    if not repair:
        return normalise(read_mesh(path), path.stem)
    from deepfracture.geometry.repair import repair as repaired

    return normalise(repaired(read_triangles(path), name=str(path)), path.stem)
