"""How a surface looks, carried from one mesh to another that lies on it.

A corner of a new face has what the old triangle has at its place: normals, texture coordinates and colours are
interpolated by its barycentric coordinates there. New inner faces get planar texture coordinates instead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry.distance import closest_points
from deepfracture.types import Appearance, Finish, Floats, Floats32, Ints, Mesh

INNER = Finish("inner", (232, 186, 150))
"""Of crack surfaces: fresh clay."""
FLAT = 1e-12
"""A triangle whose squared double area is a smaller share of its longest side's fourth power has but one direction."""
ON_SURFACE = 1e-5
"""Share of the box diagonal within which a corner lies on the surface it is said to lie on."""


def fragment_appearance(appearance: Appearance, whole: Mesh, mesh: Mesh, source: Ints) -> Appearance:
    """The appearance of a fragment of `whole`.

    Outer faces have at each corner what the whole has there. Crack faces are painted with one more finish, INNER,
    and have planar texture coordinates in metres (`planar_uv`), their own flat normals and white corners.

    Args:
        appearance: Of `whole`.
        mesh: The fragment, in the frame of `whole`.
        source: As in `Fragment`, shape (m,).
    """
    outer = np.flatnonzero(source >= 0)
    part = interpolate_appearance(appearance, whole, mesh.vertices[mesh.faces[outer]], source[outer])
    finish = np.full(len(source), len(appearance.finishes), np.int32)
    finish[outer] = part.finish
    uv = planar_uv(mesh, source < 0)
    if part.uv is not None:
        uv[outer] = part.uv
    normals = colours = None
    if part.normals is not None:
        normals = np.empty((len(source), 3, 3), np.float32)
        normals[outer] = part.normals
        stone = np.flatnonzero(source < 0)
        normals[stone] = _unit(_area_vectors(mesh.vertices[mesh.faces[stone]]))[:, None]
    if part.colours is not None:
        colours = np.full((len(source), 3, 4), 255, np.uint8)
        colours[outer] = part.colours
    return Appearance(finish, (*appearance.finishes, INNER), normals, uv, colours)


def interpolate_appearance(appearance: Appearance, whole: Mesh, triangles: Floats, source: Ints) -> Appearance:
    """The appearance of triangles (k, 3, 3) that lie in the faces `source` (k,) of `whole`."""
    shares = barycentric(whole.vertices[whole.faces[source]], triangles)
    normals = uv = colours = None
    if appearance.normals is not None:
        normals = _interpolate(shares, appearance.normals, source)
        lost = np.flatnonzero((np.einsum("kni,kni->kn", normals, normals) < 1e-12).any(axis=1))
        normals[lost] = _area_vectors(whole.vertices[whole.faces[source[lost]]])[:, None]  # opposite ones cancelled
        normals = _unit(normals).astype(np.float32)
    if appearance.uv is not None:
        uv = _interpolate(shares, appearance.uv, source).astype(np.float32)
    if appearance.colours is not None:
        colours = np.rint(_interpolate(shares, appearance.colours, source)).astype(np.uint8)
    return replace(appearance, finish=appearance.finish[source], normals=normals, uv=uv, colours=colours)


def barycentric(triangles: Floats, points: Floats) -> Floats:
    """Shares (k, n, 3), none negative, sum one, of each triangle's (k, 3, 3) corners in its n points (k, n, 3).

    Points off the triangle by rounding are taken back into it. A triangle without area counts as its longest side."""
    shares = np.empty((*points.shape[:2], 3))
    _fill_barycentric(np.ascontiguousarray(triangles), np.ascontiguousarray(points), shares)
    return shares


@njit(cache=True, inline="always")
def _dot(a, b):  # pragma: no cover
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, inline="always")
def _sub(a, b):  # pragma: no cover
    return b[0] - a[0], b[1] - a[1], b[2] - a[2]


@njit(cache=True, nogil=True)
def _fill_barycentric(triangles, points, shares):  # pragma: no cover
    for t in range(len(triangles)):
        a = triangles[t, 0]
        u, v = _sub(a, triangles[t, 1]), _sub(a, triangles[t, 2])
        # Ericson 2005, Real-Time Collision Detection, 3.4
        uu, uv, vv = _dot(u, u), _dot(u, v), _dot(v, v)
        square = uu * vv - uv * uv
        longest = max(uu, vv, uu + vv - 2 * uv)
        flat = square <= FLAT * longest * longest
        for n in range(points.shape[1]):
            p = _sub(a, points[t, n])
            pu, pv = _dot(p, u), _dot(p, v)
            if not flat:
                second, third = (vv * pu - uv * pv) / square, (uu * pv - uv * pu) / square
            elif uu == longest:
                second, third = (pu / uu if uu > 0 else 0.0), 0.0
            elif vv == longest:
                second, third = 0.0, pv / vv
            else:
                third = (pv - pu - uv + uu) / longest
                second = 1 - third
            second, third = min(max(second, 0.0), 1.0), min(max(third, 0.0), 1.0)
            first = max(1 - second - third, 0.0)
            total = first + second + third
            shares[t, n, 0], shares[t, n, 1], shares[t, n, 2] = first / total, second / total, third / total


def planar_uv(mesh: Mesh, faces: NDArray[np.bool_]) -> Floats32:
    """Texture coordinates in metres (m, 3, 2) of the chosen faces, zero elsewhere.

    Each face is seen along the axis that its surroundings face most; away from a crack's rim both of its sides get
    the same coordinates, so that the grain of the stone goes on from one fragment to the next."""
    uv = np.zeros((len(mesh.faces), 3, 2), np.float32)
    chosen = mesh.faces[faces]
    flat = _area_vectors(mesh.vertices[chosen])
    # Faces between two axes would fall to either at random: all that touch a face have a say.
    around = np.stack([np.bincount(chosen.ravel(), np.repeat(n, 3), len(mesh.vertices)) for n in flat.T], axis=1)
    axis = np.abs(around[chosen].sum(axis=1)).argmax(axis=1)
    across = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    uv[faces] = np.take_along_axis(mesh.vertices[chosen], across[:, None, :], axis=2)
    return uv


def transfer_appearance(appearance: Appearance, before: Mesh, after: Mesh) -> tuple[Appearance, int]:
    """The appearance of `after`, a cleaned or repaired `before`; and how many of its faces are new.

    A face with the corners of an old one, in whatever order, has just what that had; normals point outward. Any other
    has what the surface has nearest to it; where it leaves that surface, its normals are its own."""
    old = _matching_faces(before, after)
    lost = np.flatnonzero(old < 0)
    if len(lost):
        old[lost] = closest_points(before, after.triangles[lost].mean(axis=1)).faces
    limit = ON_SURFACE * np.linalg.norm(np.ptp(before.bounds, axis=0))
    moved = _corner_distances(before.triangles[old[lost]], after.triangles[lost]) > limit
    lost = lost[moved]  # the others were only welded
    look = interpolate_appearance(appearance, before, after.triangles, old)
    if look.normals is None:
        return look, len(lost)
    flat = _unit(after.area_vectors)
    inward = np.einsum("mki,mi->m", look.normals, flat) < 0
    normals = np.where(inward[:, None, None], -look.normals, look.normals)
    off = closest_points(before, after.triangles[lost].reshape(-1, 3)).distance.reshape(-1, 3).max(axis=1)
    strays = lost[off > limit]
    normals[strays] = flat[strays, None]
    return replace(look, normals=normals), len(lost)


def _corner_distances(one: Floats, other: Floats) -> Floats:
    """How far the corners of triangles (k, 3, 3) are from the nearest of others', at most, shape (k,)."""
    apart = np.linalg.norm(one[:, :, None] - other[:, None], axis=-1)
    return apart.min(axis=1).max(axis=1)


def _matching_faces(before: Mesh, after: Mesh) -> Ints:
    """For each face of `after` the first of `before` with the same corners, -1 if there is none."""
    places = np.concatenate([before.vertices, after.vertices]) + 0.0  # -0 and 0 are one place
    point = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
    corners = np.sort(point[np.concatenate([before.faces, after.faces + len(before.vertices)])], axis=1)
    order = np.lexsort(corners.T)
    new = np.concatenate([[True], (np.diff(corners[order], axis=0) != 0).any(axis=1)])
    # Sorting is stable: the first of a run of equal faces is the earliest.
    first = np.empty(len(corners), np.int64)
    first[order] = order[np.flatnonzero(new)][np.cumsum(new) - 1]
    old = first[len(before.faces) :]
    return np.where(old < len(before.faces), old, -1)


def _interpolate(shares: Floats, values: NDArray, source: Ints) -> Floats:
    """Corner values (m, 3, c) of the triangles `source` (k,) in shares (k, n, 3), shape (k, n, c)."""
    mixed = np.empty((*shares.shape[:2], values.shape[2]))
    _fill_interpolated(shares, values, source, mixed)
    return mixed


@njit(cache=True, nogil=True)
def _fill_interpolated(shares, values, source, mixed):  # pragma: no cover
    for t in range(len(source)):
        old = values[source[t]]
        for n in range(shares.shape[1]):
            for c in range(mixed.shape[2]):
                mixed[t, n, c] = shares[t, n, 0] * old[0, c] + shares[t, n, 1] * old[1, c] + shares[t, n, 2] * old[2, c]


def _area_vectors(triangles: Floats) -> Floats:
    """Outward normals times area of triangles (k, 3, 3), shape (k, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def _unit(vectors: Floats) -> Floats:
    """Unit vectors; what has no length points along z."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    blank = length == 0
    if not blank.any():
        return vectors / length
    return np.where(blank, [0.0, 0.0, 1.0], vectors / np.where(blank, 1.0, length))
