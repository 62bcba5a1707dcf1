"""What a body looks like: its surfaces, split where they crease, with normals and colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Floats, Floats32, Ints, Mesh, Track

OUTER_CREASE = 40.0
"""Degrees between two faces beyond which an original surface shows an edge."""
INNER_CREASE = 25.0
"""The same on crack surfaces, which look rough."""

COLOURS: dict[str, tuple[int, int, int]] = {
    "outer": (189, 94, 61),  # terracotta
    "inner": (232, 186, 150),  # fresh clay
    "ball": (62, 72, 84),  # steel
    "floor": (236, 233, 228),
    "block": (150, 152, 156),  # granite
}
"""sRGB, 0..255, of each kind of surface."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of one look, in the frame of the mesh they came from."""

    look: str
    """Key into COLOURS."""
    vertices: Floats32
    """Shape (n, 3); a point on a crease appears once for each side."""
    normals: Floats32
    """Unit normals of the vertices, shape (n, 3)."""
    faces: Ints
    """Shape (m, 3)."""


def surfaces(mesh: Mesh, source: Ints | None, look: str = "outer") -> tuple[Surface, ...]:
    """The original surface (`look`) and, where `source` is -1, the crack surface ("inner")."""
    if source is None:
        return (_shaded(mesh, mesh.faces, look, OUTER_CREASE),)
    cracked = np.asarray(source) < 0
    parts = ((mesh.faces[~cracked], look, OUTER_CREASE), (mesh.faces[cracked], "inner", INNER_CREASE))
    return tuple(_shaded(mesh, faces, name, crease) for faces, name, crease in parts if len(faces))


def track_surfaces(track: Track) -> tuple[Surface, ...]:
    """The surfaces of one body of a recording."""
    return surfaces(track.mesh, track.source, track.kind if track.kind in COLOURS else "outer")


def _shaded(mesh: Mesh, faces: Ints, look: str, crease: float) -> Surface:
    """Corners share a normal when a chain of smooth edges around their vertex joins them."""
    normals, angles = _face_normals(mesh.vertices[faces])
    group, count = _smooth_corners(faces, normals, np.cos(np.radians(crease)))
    # Thuermer and Wuethrich 1998: weights by corner angle do not depend on the triangulation
    weighted = (normals[:, None, :] * angles[:, :, None]).reshape(-1, 3)
    summed = np.stack([np.bincount(group, weighted[:, k], count) for k in range(3)], axis=1)
    length = np.linalg.norm(summed, axis=1)
    flat = length < 1e-12  # only faces without area meet here: any direction will do, nobody sees them
    summed[flat], length[flat] = (0.0, 0.0, 1.0), 1.0
    vertex = np.zeros(count, dtype=np.int64)
    vertex[group] = faces.ravel()
    return Surface(
        look,
        mesh.vertices[vertex].astype(np.float32),
        (summed / length[:, None]).astype(np.float32),
        group.reshape(-1, 3).astype(np.int64),
    )


def _face_normals(triangles: Floats) -> tuple[Floats, Floats]:
    """Unit normals (m, 3), zero for faces without area, and corner angles [rad] (m, 3)."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    cross = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    normals = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
    out, back = edges, -np.roll(edges, 1, axis=1)
    sine = np.linalg.norm(np.cross(out, back), axis=2)
    return normals, np.arctan2(sine, np.einsum("mki,mki->mk", out, back))


def _smooth_corners(faces: Ints, normals: Floats, limit: float) -> tuple[Ints, int]:
    """Group of each corner (3m,) and the number of groups."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corner = np.arange(faces.size).reshape(-1, 3)
    following = np.roll(corner, -1, axis=1)
    low, high = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2).T
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    left, right = order[:-1][same], order[1:][same]
    a, b = normals[left // 3], normals[right // 3]
    blank = ~(a.any(axis=1) & b.any(axis=1))
    smooth = blank | (np.einsum("ni,ni->n", a, b) >= limit)
    left, right = left[smooth], right[smooth]
    start, end = corner.ravel(), following.ravel()
    flipped = faces.ravel()[start[left]] != faces.ravel()[start[right]]
    first = np.concatenate([start[left], end[left]])
    near, far = start[right], end[right]
    second = np.concatenate([np.where(flipped, far, near), np.where(flipped, near, far)])
    links = coo_matrix((np.ones(len(first), np.int8), (first, second)), (faces.size, faces.size))
    count, group = connected_components(links, directed=False)
    return group.astype(np.int64), int(count)
