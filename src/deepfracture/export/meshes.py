"""Fragments as mesh files, in the coordinates of the user's file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..types import Fragment, Fragments, Shape
from .files import replacing_folder
from .surface import COLOURS


def write_fragments(fragments: Fragments, shape: Shape, folder: str | os.PathLike) -> list[Path]:
    """Write fragment_000.ply ... into `folder`, which appears whole or not at all; returns their paths.

    Binary PLY, closed, in the user's coordinates. Each face has a colour (crack surfaces lighter)
    and an int property `source`: its triangle in the original mesh, -1 on a crack surface.
    """
    folder = Path(folder)
    names = [f"fragment_{k:03d}.ply" for k in range(len(fragments))]
    with replacing_folder(folder) as temporary:
        for name, piece in zip(names, fragments, strict=True):
            (temporary / name).write_bytes(_ply(piece, shape))
    return [folder / name for name in names]


def _ply(piece: Fragment, shape: Shape) -> bytes:
    vertices = shape.to_user(piece.mesh.vertices)
    faces = np.empty(
        len(piece.mesh.faces),
        dtype=[("count", "u1"), ("corners", "<i4", 3), ("colour", "u1", 4), ("source", "<i4")],
    )
    faces["count"], faces["corners"], faces["source"] = 3, piece.mesh.faces, piece.source
    outer, inner = ((*COLOURS[look], 255) for look in ("outer", "inner"))
    faces["colour"] = np.where((piece.source < 0)[:, None], inner, outer)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment a fragment of {shape.name}, {piece.mass:.9g} kg",
        f"element vertex {len(vertices)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        *(f"property uchar {name}" for name in ("red", "green", "blue", "alpha")),
        "property int source",
        "end_header",
    ]
    return "\n".join(header).encode() + b"\n" + vertices.astype("<f8").tobytes() + faces.tobytes()
