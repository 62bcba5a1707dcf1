"""What a body looks like: its surfaces, split where they crease, with normals and colours."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepfracture.geometry.appearance import INNER, interpolate_appearance, planar_uv
from deepfracture.types import Appearance, Finish, Floats, Floats32, Ints, Mesh, Shape, Track

OUTER_CREASE = 40.0
"""Degrees between two faces beyond which an original surface shows an edge."""
INNER_CREASE = 25.0
"""The same on crack surfaces, which look rough."""

ROUGHNESS = {"outer": 0.75, "inner": 0.95, "ball": 0.35, "floor": 0.9, "block": 0.8}
METALLIC = {"ball": 0.6}
"""Of materials that know both; what is not named is no metal."""
COLOURS: dict[str, tuple[int, int, int]] = {
    "outer": (189, 94, 61),  # terracotta
    "inner": INNER.colour or (255, 255, 255),
    "ball": (62, 72, 84),  # steel
    "floor": (236, 233, 228),
    "block": (150, 152, 156),  # granite
}
"""sRGB, 0..255, of each kind of surface."""


WHITE = (255, 255, 255)
SAME_NORMAL, SAME_UV = 1e-4, 1e-6
"""Corners that differ by less, in units of a unit normal and of a texture's side, share a vertex."""


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
    origin: Ints
    """The vertex of the mesh that each vertex is, shape (n,)."""
    uv: Floats32 | None = None
    """Texture coordinates of the vertices, v upward, shape (n, 2)."""
    colours: NDArray[np.uint8] | None = None
    """sRGB and opacity of the vertices, which tint what `finish` says, shape (n, 4)."""
    finish: Finish = field(default_factory=Finish)
    """What it is painted with; where that says nothing, the colour of its look."""

    @property
    def name(self) -> str:
        """Of its material: the user's own, else that of its look."""
        return self.finish.name or self.look

    @property
    def base(self) -> tuple[int, int, int]:
        """sRGB, 0..255, by which colours and texture are multiplied."""
        if self.finish.texture is not None and self.uv is not None:
            return WHITE
        plain = COLOURS[self.look] if self.colours is None else WHITE
        return plain if self.finish.colour is None else self.finish.colour


def surfaces(
    mesh: Mesh, source: Ints | None, look: str = "outer", *, whole: Shape | None = None
) -> tuple[Surface, ...]:
    """The original surface (`look`) and, where `source` is -1, the crack surface ("inner").

    whole: what `source` refers to; with it the original surface is as smooth as it was before it broke, has the
    paint of the user's file, and comes in as many parts as that has finishes. Crack surfaces have `planar_uv`."""
    cracked = np.zeros(len(mesh.faces), bool) if source is None else np.asarray(source) < 0
    outer = () if cracked.all() else _outer(mesh, np.flatnonzero(~cracked), source, look, whole)
    if not cracked.any():
        return outer
    return (*outer, _stone(mesh, cracked))


def linear(value: ArrayLike) -> Floats:
    """Linear light 0..1 of sRGB 0..1 (IEC 61966-2-1)."""
    value = np.asarray(value, float)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def track_surfaces(track: Track) -> tuple[Surface, ...]:
    """The surfaces of one body of a recording."""
    look = track.kind if track.kind in COLOURS else "outer"
    return surfaces(track.mesh, track.source, look, whole=track.whole)


@lru_cache(maxsize=8)
def painted(shape: Shape) -> Appearance:
    """How a shape looks, with normals where its file has none: by its creases."""
    faces = np.zeros(len(shape.mesh.faces), np.int32)
    given = Appearance(faces) if shape.appearance is None else shape.appearance
    if given.normals is not None:
        return given
    smooth = _shaded(shape.mesh, shape.mesh.faces, "outer", OUTER_CREASE)
    return replace(given, normals=smooth.normals[smooth.faces])


def _outer(mesh: Mesh, faces: Ints, source: Ints | None, look: str, whole: Shape | None) -> tuple[Surface, ...]:
    """The original surface: one for each finish that is seen."""
    if whole is None:
        return (_shaded(mesh, mesh.faces[faces], look, OUTER_CREASE),)
    paint = painted(whole)
    if source is not None:
        paint = interpolate_appearance(paint, whole.mesh, mesh.triangles[faces], source[faces])
    parts = [(k, np.flatnonzero(paint.finish == k)) for k in np.unique(paint.finish)]
    return tuple(_painted(mesh, mesh.faces[faces[own]], look, paint, own, paint.finishes[k]) for k, own in parts)


def _painted(mesh: Mesh, faces: Ints, look: str, paint: Appearance, own: Ints, finish: Finish) -> Surface:
    """The faces `own` of an appearance; corners that are alike in all share a vertex."""
    assert paint.normals is not None
    normals = paint.normals[own].reshape(-1, 3)
    uv = None if paint.uv is None else paint.uv[own].reshape(-1, 2)
    colours = None if paint.colours is None else paint.colours[own].reshape(-1, 4)
    keys = [faces.reshape(-1, 1), np.rint(normals / SAME_NORMAL)]
    keys += [] if uv is None else [np.rint(uv.astype(float) / SAME_UV)]
    keys += [] if colours is None else [colours]
    first, vertex = _alike(keys)
    return Surface(
        look,
        mesh.vertices[faces.ravel()[first]].astype(np.float32),
        normals[first],
        vertex.reshape(-1, 3),
        faces.ravel()[first],
        None if uv is None else uv[first],
        None if colours is None else colours[first],
        finish,
    )


def _stone(mesh: Mesh, cracked: NDArray[np.bool_]) -> Surface:
    """The crack surface, a vertex for each of the texture coordinates that meet there."""
    surface = _shaded(mesh, mesh.faces[cracked], "inner", INNER_CREASE)
    uv = planar_uv(mesh, cracked)[cracked].reshape(-1, 2)
    first, vertex = _alike([surface.faces.reshape(-1, 1), uv])
    old = surface.faces.ravel()[first]
    vertices, normals = surface.vertices[old], surface.normals[old]
    return Surface("inner", vertices, normals, vertex.reshape(-1, 3), surface.origin[old], uv[first], finish=INNER)


def _alike(columns: list[NDArray]) -> tuple[Ints, Ints]:
    """The first row of each kind, and the kind of each row, of columns side by side (n, ...)."""
    table = np.concatenate([np.asarray(column, float) for column in columns], axis=1)
    order = np.lexsort(table.T[::-1])
    new = np.concatenate([[True], (np.diff(table[order], axis=0) != 0).any(axis=1)])
    kind = np.empty(len(order), np.int64)
    kind[order] = np.cumsum(new) - 1
    return order[new], kind


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
        vertex,
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
