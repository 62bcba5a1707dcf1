"""Fragments as Wavefront OBJ with the user's own materials, and one more for the stone inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deepfracture.geometry.appearance import INNER
from deepfracture.recording.surface import COLOURS
from deepfracture.types import Appearance, Finish, Fragment, Shape

LIBRARY = "fragments.mtl"


def write_obj(path: Path, piece: Fragment, shape: Shape, look: Appearance) -> None:
    """A closed mesh in the user's coordinates: faces by material, corners with texture coordinates and normals.

    `look` is that of the fragment (`carried`). Crack faces use the material "inner" and planar coordinates [m]."""
    assert look.normals is not None and look.uv is not None and shape.appearance is not None
    inner = len(look.finishes) - 1
    mapped = np.repeat((look.finish == inner) | (shape.appearance.uv is not None), 3)
    spots, spot = np.unique(look.uv.reshape(-1, 2)[mapped].round(6) + 0.0, axis=0, return_inverse=True)
    ways, way = np.unique(look.normals.reshape(-1, 3).round(5) + 0.0, axis=0, return_inverse=True)
    at = np.full(mapped.shape, "", object)
    at[mapped] = [str(k) for k in (spot.reshape(-1) + 1).tolist()]
    vertex, way = (piece.mesh.faces.ravel() + 1).tolist(), (way.reshape(-1) + 1).tolist()
    corners = [f"{v}/{t}/{n}" for v, t, n in zip(vertex, at, way, strict=True)]
    names = _names(look.finishes[:inner])
    lines = [f"# a fragment of {' '.join(shape.name.split())}, {piece.mass:.9g} kg", f"mtllib {LIBRARY}"]
    lines += [f"o {path.stem}"]
    lines += _lines("v", "%.9g %.9g %.9g", shape.to_user(piece.mesh.vertices))
    lines += _lines("vt", "%.6f %.6f", spots) + _lines("vn", "%.5f %.5f %.5f", ways)
    for k in np.unique(look.finish).tolist():
        lines.append(f"usemtl {INNER.name if k == inner else names[k]}")
        lines += [f"f {' '.join(corners[3 * f : 3 * f + 3])}" for f in np.flatnonzero(look.finish == k).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_library(folder: Path, appearance: Appearance) -> None:
    """The materials of all fragments, with their textures beside them."""
    lines = []
    for k, (name, finish) in enumerate(zip(_names(appearance.finishes), appearance.finishes, strict=True)):
        plain = COLOURS["outer"] if appearance.colours is None else (255, 255, 255)
        lines += material_lines(name, plain if finish.colour is None else finish.colour)
        if finish.texture is not None:
            picture = picture_name(k, finish.texture)
            (folder / picture).write_bytes(finish.texture)
            lines.append(f"map_Kd {picture}")
    lines += material_lines(INNER.name, COLOURS["inner"])
    (folder / LIBRARY).write_text("\n".join(lines) + "\n", encoding="utf-8")


def picture_name(number: int, data: bytes) -> str:
    """Of a texture's file, by what it is."""
    return f"texture_{number}." + ("png" if data.startswith(b"\x89PNG") else "jpg")


def material_lines(name: str, colour: tuple[int, int, int]) -> list[str]:
    """A plain material of an .mtl file."""
    red, green, blue = (c / 255 for c in colour)
    return [f"newmtl {name}", f"Kd {red:.4f} {green:.4f} {blue:.4f}", "Ks 0 0 0", "d 1", "illum 2"]


def _names(finishes: tuple[Finish, ...]) -> list[str]:
    """A name for each finish, in one word, none of them twice or that of the stone."""
    names: list[str] = []
    for k, finish in enumerate(finishes):
        name = "_".join(finish.name.split()) or "outer"
        names.append(f"{name}_{k}" if name in (*names, INNER.name) else name)
    return names


def _lines(key: str, form: str, rows: NDArray) -> list[str]:
    return [f"{key} {form}" % tuple(row) for row in rows.tolist()]
