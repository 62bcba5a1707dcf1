"""Fragments as mesh files, in the coordinates of the user's file."""

from __future__ import annotations

import io
import os
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deepfracture.export.wavefront import write_library, write_obj
from deepfracture.geometry.appearance import fragment_appearance
from deepfracture.recording.surface import COLOURS, painted
from deepfracture.runtime.files import atomic_folder
from deepfracture.types import Appearance, Floats, Fragment, Fragments, Shape


def write_fragments(fragments: Fragments, shape: Shape, folder: str | os.PathLike) -> list[Path]:
    """Write fragment_000.ply ... into `folder`, which appears whole or not at all; returns their paths.

    Binary PLY, closed, in the user's coordinates. Each face has a colour (crack surfaces lighter)
    and an int property `source`: its triangle in the original mesh, -1 on a crack surface.
    A shape with an appearance also gets fragment_000.obj ... with its materials, texture coordinates and normals.
    """
    folder = Path(folder)
    names = [f"fragment_{k:03d}" for k in range(len(fragments))]
    paint = painted(shape)
    with atomic_folder(folder) as temporary:
        for name, piece in zip(names, fragments, strict=True):
            look = fragment_appearance(paint, shape.mesh, piece.mesh, piece.source)
            (temporary / f"{name}.ply").write_bytes(_ply(piece, shape, look))
            if shape.appearance is not None:
                write_obj(temporary / f"{name}.obj", piece, shape, look)
        if shape.appearance is not None:
            write_library(temporary, shape.appearance)
    return [folder / f"{name}.ply" for name in names]


def _ply(piece: Fragment, shape: Shape, look: Appearance) -> bytes:
    vertices = shape.to_user(piece.mesh.vertices)
    faces = np.empty(
        len(piece.mesh.faces),
        dtype=[("count", "u1"), ("corners", "<i4", 3), ("colour", "u1", 4), ("source", "<i4")],
    )
    faces["count"], faces["corners"], faces["source"] = 3, piece.mesh.faces, piece.source
    faces["colour"] = _face_colours(look)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment a fragment of {' '.join(shape.name.split())}, {piece.mass:.9g} kg",
        f"element vertex {len(vertices)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        *(f"property uchar {name}" for name in ("red", "green", "blue", "alpha")),
        "property int source",
        "end_header",
    ]
    return "\n".join(header).encode() + b"\n" + vertices.astype("<f8").tobytes() + faces.tobytes()


def _face_colours(look: Appearance) -> NDArray[np.uint8]:
    """sRGB and opacity in the middle of each face of a fragment, shape (m, 4)."""
    tint = np.full((len(look.finish), 4), 255.0) if look.colours is None else look.colours.mean(axis=1)
    for k, finish in enumerate(look.finishes):
        own = look.finish == k
        if finish.texture is not None and look.uv is not None:
            tint[own, :3] *= texels(finish.texture, look.uv[own].mean(axis=1)) / 255
        elif finish.colour is not None:
            tint[own, :3] *= np.array(finish.colour) / 255
        elif look.colours is None:
            tint[own, :3] = COLOURS["outer"]
    return np.rint(tint).astype(np.uint8)


def texels(texture: bytes, uv: NDArray) -> Floats:
    """sRGB of a texture, which repeats, at uv (n, 2), shape (n, 3)."""
    rows = _decoded(texture)
    height, width = rows.shape[:2]
    column = np.floor(uv[:, 0] % 1 * width).astype(int) % width
    row = np.floor(-uv[:, 1] % 1 * height).astype(int) % height
    return rows[row, column].astype(float)


@lru_cache(maxsize=4)
def _decoded(texture: bytes) -> NDArray[np.uint8]:
    """sRGB of a picture, shape (h, w, 3): every fragment asks for the same."""
    from PIL import Image

    with Image.open(io.BytesIO(texture)) as picture:
        return np.asarray(picture.convert("RGB"))
