"""Shapes by name: a built-in one, or that of a mesh file."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from deepfracture.geometry.appearance import transfer_appearance
from deepfracture.geometry.builtin import builtin
from deepfracture.geometry.normalise import normalise
from deepfracture.geometry.read import check_solid, read_soup, weld_soup
from deepfracture.geometry.soup import TriangleSoup
from deepfracture.geometry.untangle import self_intersecting_faces
from deepfracture.runtime.progress import log
from deepfracture.types import Appearance, BadInput, Mesh, Shape


def load_shape(path_or_name: str, *, repair: bool = False) -> Shape:
    """A built-in shape by its name, or the shape in a mesh file (OBJ, STL, PLY, GLB, GLTF, OFF) with its looks.

    repair: close what is open, join overlapping shells. Raises BadInput in one line."""
    text = str(path_or_name)
    path = Path(text)
    if not text.strip() or (not path.suffix and not os.path.isfile(path)):
        return builtin(text)
    soup = read_soup(path)
    mesh = weld_soup(soup, path)
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
    count = len(self_intersecting_faces(shape.mesh))
    if count:
        log.warning(
            "%s: the surface runs through itself (%d faces): cuts may fail there; --repair fixes that",
            name,
            count,
        )


def _appearance(soup: TriangleSoup, mesh: Mesh, name: str) -> Appearance | None:
    """What the file says of the looks of the mesh that was made of it, None if it says nothing."""
    try:
        given = soup.appearance()
    except BadInput as problem:
        raise BadInput(f"{name}: {problem}; export it again") from None
    if given is None:
        return None
    appearance, new = transfer_appearance(given, Mesh(soup.vertices, soup.faces), mesh)
    if new:
        log.info("%s: %d of %d faces are new and look like what is nearest to them", name, new, len(mesh.faces))
    return appearance
