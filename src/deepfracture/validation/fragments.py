"""What a set of fragments must satisfy, measured: sound solids, the original's outside, cracks that fit together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.geometry import signed_distance_points
from deepfracture.geometry.aabb_tree import offset_from_triangle
from deepfracture.geometry.intersect import self_intersections
from deepfracture.geometry.topology import compact, edges_of, fans, radix_argsort, shell_volumes, shells
from deepfracture.types import BadInput, Floats, Fragments, Ints, Mesh, Shape

SMALL = 1e-4
"""Share of a voxel below which an edge or an altitude counts as small."""
VOLUME_LIMIT = 1e-6
"""Relative error of the fragments' volumes together."""
AREA_LIMIT = 1e-6
"""Relative error of the area of outside faces in one triangle of the original."""
OUTSIDE_LIMIT = 1e-8
"""Distance [m] that outside faces may keep from their triangle of the original."""
LOW = 1e-6
"""Altitude [m] of triangles that are too thin for an orientation, and for an area to be relative to."""
AROUND = 2.0
"""Voxels around a point of a crack in which a plane is fitted to it."""
TINY = float(np.finfo(float).tiny)
"""Least divisor."""
SAMPLES = 400
"""Points at which roughness is measured, at most."""


@dataclass(frozen=True)
class FragmentCheck:
    """One fragment as a solid. All of the counts are zero and `bodies` is one where it is sound."""

    faces: int
    volume: float
    """[m^3]"""
    torn: int
    """Directed edges that do not occur once with their opposite once."""
    pinched: int
    """Fans of faces beyond one a vertex; vertices at one position count as different ones."""
    bodies: int
    """Connected surfaces that face outwards."""
    stray: int
    """Connected surfaces that face inwards, but are no void inside a body."""
    crossings: int
    """Pairs of faces that run through each other, but for inherited ones."""
    inherited: int
    """Pairs of outside faces that do so because the triangles of the original do in which they lie."""
    euler: int
    """Vertices - edges + faces: 2 for a ball, less 2 for each handle, 2 more for each void."""
    shortest: float
    """Shortest edge [voxels]."""
    lowest: float
    """Smallest altitude of a face [voxels]."""
    short: float
    """Share of edges below SMALL."""
    low: float
    """Share of faces whose altitude is below SMALL."""


@dataclass(frozen=True)
class OutsideCheck:
    """The outside faces of all fragments against the original's triangles."""

    faces: int
    distance: float
    """Largest distance [m] of a corner from the triangle of the original that it lies in."""
    flipped: int
    """Faces turned against their triangle."""
    area_error: float
    """Largest relative error of the area of faces in one triangle of the original."""
    missing: int
    """Triangles of the original in which the area is wrong by more than AREA_LIMIT."""


@dataclass(frozen=True)
class CrackCheck:
    """The inner faces of all fragments."""

    faces: int
    alone: int
    """Faces without exactly one mirror image, of equal corners, in another fragment."""
    bends: tuple[float, float, float]
    """Median, 90th and 99th percentile by length of the angle [degrees] between faces with a common edge, within the
    crack between two fragments; 0 is flat."""
    roughness: float
    """Root mean square distance [voxels] of the corners within a crack from the plane fitted to the corners up to
    AROUND voxels away: 0 for a plane, about 0.3 for voxel stairs."""


@dataclass(frozen=True)
class FragmentReport:
    """A set of fragments and all that is wrong with it."""

    pieces: tuple[FragmentCheck, ...]
    volume_error: float
    """Of their sum, relative."""
    outside: OutsideCheck
    cracks: CrackCheck

    @property
    def failures(self) -> dict[str, int]:
        """How many of what is wrong, by kind; empty where nothing is."""
        pieces = self.pieces
        found = {
            "volume": int(not abs(self.volume_error) <= VOLUME_LIMIT),
            "torn": sum(piece.torn > 0 for piece in pieces),
            "pinched": sum(piece.pinched > 0 for piece in pieces),
            "apart": sum(piece.bodies != 1 or piece.stray > 0 for piece in pieces),
            "crossing": sum(piece.crossings > 0 for piece in pieces),
            "inside out": sum(not piece.volume > 0 for piece in pieces),
            "outside moved": int(not self.outside.distance <= OUTSIDE_LIMIT),
            "outside flipped": self.outside.flipped,
            "outside missing": self.outside.missing,
            "crack alone": self.cracks.alone,
        }
        return {kind: count for kind, count in found.items() if count}


def check_fragments(shape: Shape, fragments: Fragments, *, voxel: float) -> FragmentReport:
    """Measure what must hold of the fragments of a shape.

    Each fragment: closed, 2-manifold, outward, one body, without self-intersection. All of them: they fill the shape,
    their outside is the shape's, and each inner face has its mirror image in one neighbour.

    Args:
        voxel: Spacing [m] of the grid that the cracks were drawn on, the unit of small lengths.

    Raises:
        BadInput: There is no fragment, a source is no face of the shape, or `voxel` is not positive.
    """
    if not len(fragments):
        raise BadInput("fragments: there are none")
    if not voxel > 0:
        raise BadInput(f"voxel must be positive, got {voxel}")
    meshes = [piece.mesh for piece in fragments]
    source = np.concatenate([piece.source for piece in fragments])
    if source.max(initial=-1) >= len(shape.mesh.faces):
        raise BadInput(f"source must index {len(shape.mesh.faces)} faces of {shape.name}, got {source.max()}")
    crossings = [self_intersections(mesh) for mesh in meshes]
    inherited = _inherited(shape.mesh, fragments, crossings)
    return FragmentReport(
        tuple(_check_piece(*piece, voxel) for piece in zip(meshes, map(len, crossings), inherited, strict=True)),
        fragments.volume / shape.mesh.volume - 1,
        _check_outside(shape.mesh, np.concatenate([mesh.triangles for mesh in meshes]), source),
        _check_cracks(meshes, source < 0, voxel),
    )


def _inherited(original: Mesh, fragments: Fragments, crossings: Sequence[Ints]) -> list[int]:
    """How many of each fragment's crossings the original has itself."""
    if not any(map(len, crossings)):
        return [0] * len(crossings)
    n = len(original.faces)
    known = self_intersections(original) @ [n, 1]
    pairs = [np.sort(piece.source[found], axis=1) for piece, found in zip(fragments, crossings, strict=True)]
    return [int(np.isin(pair @ [n, 1], known)[pair[:, 0] >= 0].sum()) for pair in pairs]


def _check_piece(mesh: Mesh, crossings: int, inherited: int, voxel: float) -> FragmentCheck:
    edges = edges_of(mesh.faces)
    # An edge from a vertex to itself is its own opposite.
    sound = edges.manifold | ((edges.counts == 1) & edges.self_loops)
    used = int(np.count_nonzero(np.bincount(mesh.faces.ravel())))
    bodies, stray = _bodies(mesh, shells(mesh.faces, edges))
    lengths, altitudes = _measured(mesh.triangles)
    return FragmentCheck(
        faces=len(mesh.faces),
        volume=mesh.volume,
        torn=int(edges.counts[~sound].sum()),
        pinched=int(fans(mesh.faces, edges).max(initial=-1)) + 1 - used,
        bodies=bodies,
        stray=stray,
        crossings=crossings - inherited,
        inherited=inherited,
        euler=used - len(edges.counts) + len(mesh.faces),
        shortest=float(lengths.min() / voxel),
        lowest=float(altitudes.min() / voxel),
        short=float((lengths < SMALL * voxel).mean()),
        low=float((altitudes < SMALL * voxel).mean()),
    )


def _bodies(mesh: Mesh, part: Ints) -> tuple[int, int]:
    """Connected surfaces that face outwards, and inward ones that lie inside none of them."""
    volumes = shell_volumes(mesh, part)
    outward = volumes > 0
    voids = np.flatnonzero(~outward)
    if not len(voids):
        return int(outward.sum()), 0
    if not outward.any():
        return 0, len(voids)
    corner = mesh.vertices[mesh.faces[[int(np.argmax(part == void)) for void in voids], 0]]
    around = compact(mesh.vertices, mesh.faces[outward[part]])
    inside = signed_distance_points(around, corner) > 0
    for n in np.flatnonzero(~inside):  # a void may touch the surface around it at this corner, but not at all of them
        distances = signed_distance_points(around, compact(mesh.vertices, mesh.faces[part == voids[n]]).vertices)
        inside[n] = distances[np.argmax(np.abs(distances))] > 0
    return int(outward.sum()), int((~inside).sum())


def _check_outside(original: Mesh, triangles: Floats, source: Ints) -> OutsideCheck:
    own = source >= 0
    triangles, source = triangles[own], source[own]
    normals = original.area_vectors
    areas = np.linalg.norm(normals, axis=1)
    units = normals / np.maximum(areas, TINY)[:, None]
    vectors = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    along = np.einsum("ni,ni->n", vectors, units[source])
    lengths, altitudes = _measured(original.triangles)
    firm = (_measured(triangles)[1] > LOW) & (altitudes > LOW)[source]
    covered = np.bincount(source, weights=along, minlength=len(areas))
    error = np.abs(covered - areas) / np.maximum(areas, LOW * lengths.max(axis=1) / 2)
    distances = _distances(triangles, original.triangles, source)
    return OutsideCheck(
        faces=len(source),
        distance=float(distances.max(initial=0)),
        flipped=int((firm & (along <= 0)).sum()),
        area_error=float(error.max(initial=0)),
        missing=int((~(error <= AREA_LIMIT)).sum()),
    )


def _check_cracks(meshes: Sequence[Mesh], inner: np.ndarray, voxel: float) -> CrackCheck:
    """`inner`: for each face of all fragments, one after the other, whether it lies on a crack."""
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])[inner]
    points, faces = _common_points(meshes, inner)
    partner = _partners(faces, owner, _measured(points[faces])[1] <= LOW)
    fits = partner >= 0
    # Each crack once, seen from the fragment with the lower number.
    seen = fits & (owner < owner[partner])
    faces, crack = faces[seen], np.column_stack([owner[seen], owner[partner[seen]]])
    return CrackCheck(
        faces=int(inner.sum()),
        alone=int((~fits).sum()),
        bends=_bends(points, faces, crack, voxel),
        roughness=_roughness(points, faces, crack, voxel),
    )


def _common_points(meshes: Sequence[Mesh], inner: np.ndarray) -> tuple[Floats, Ints]:
    """The positions of the corners of inner faces, each once and ascending, and the faces between them."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])[inner]
    used = compact(np.concatenate([mesh.vertices for mesh in meshes]), faces)
    order = np.lexsort(used.vertices.T[::-1])
    points = used.vertices[order]
    new = _first(points)
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(new) - 1
    return points[new], number[used.faces]


def _first(rows: np.ndarray) -> np.ndarray:
    """Whether each row differs from the one before."""
    new = np.ones(len(rows), bool)
    new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return new


def _partners(faces: Ints, owner: Ints, thin: np.ndarray) -> Ints:
    """For each face one that has its corners in opposite order, in another fragment, and belongs to no other face; -1
    where there is none.

    Only faces without width, those that are `thin`, may have the same corners several times: then as many in the one
    fragment as mirrored in the other, and in no third."""
    partner = np.full(len(faces), -1)
    if not len(faces):
        return partner
    first = np.argmin(faces, axis=1)[:, None]
    a, b, c = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1).T
    # A face with two corners in one place looks the same from both sides.
    flat = (a == b) | (b == c) | (c == a)
    turned = (b > c) & ~flat
    corners = np.column_stack([a, np.minimum(b, c), np.maximum(b, c)])
    order = radix_argsort(np.column_stack([corners, turned, owner]))
    start = np.flatnonzero(_first(corners[order]))
    size = np.diff(start, append=len(order))
    pair = start[size == 2]
    one, other = order[pair], order[pair + 1]
    fit = ((turned[one] != turned[other]) | flat[one]) & (owner[one] != owner[other])
    one, other = one[fit], other[fit]
    partner[one], partner[other] = other, one
    many = np.add.reduceat((thin | flat)[order], start, dtype=np.int64) > 0
    sides = np.add.reduceat(turned[order], start, dtype=np.int64)
    even = (size % 2 == 0) & ((2 * sides == size) | flat[order[start]])
    for n in np.flatnonzero((size > 2) & many & even):
        own = order[start[n] : start[n] + size[n]]
        # Of two fragments the lower's faces first in the one, last in the other.
        one, other = own[: len(own) // 2], own[len(own) // 2 :][::-1]
        if len(np.unique(owner[own])) == 2 and (owner[one] != owner[other]).all():
            partner[one], partner[other] = other, one
    return partner


def _bends(points: Floats, faces: Ints, crack: Ints, voxel: float) -> tuple[float, float, float]:
    """`crack`: the two fragments beside each face, shape (m, 2)."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    face = np.arange(3 * len(faces)) // 3
    rows = np.column_stack([edges, crack[face]])
    order = radix_argsort(rows)
    edges, face = edges[order], face[order]
    pair = np.flatnonzero(~_first(rows[order])) - 1
    one, other = face[pair], face[pair + 1]
    # The direction of slivers is noise.
    corners = points[faces]
    firm = _measured(corners)[1] > voxel / 100
    keep = firm[one] & firm[other]
    if not keep.any():
        return 0.0, 0.0, 0.0
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), TINY)
    sine = np.linalg.norm(np.cross(normals[one], normals[other]), axis=1)[keep]
    angle = np.degrees(np.arctan2(sine, np.einsum("ni,ni->n", normals[one], normals[other])[keep]))
    length = np.linalg.norm(points[edges[pair, 0]] - points[edges[pair, 1]], axis=1)[keep]
    rank = np.argsort(angle)
    share = np.cumsum(length[rank]) / length.sum()
    found = [float(angle[rank[min(np.searchsorted(share, q), len(rank) - 1)]]) for q in (0.5, 0.9, 0.99)]
    return found[0], found[1], found[2]


def _roughness(points: Floats, faces: Ints, crack: Ints, voxel: float) -> float:
    from scipy.spatial import KDTree

    squares: list[float] = []
    order = radix_argsort(crack)
    for part in np.split(order, np.flatnonzero(_first(crack[order])))[1:]:
        own = points[np.unique(faces[part])]
        tree = KDTree(own)
        picks = np.linspace(0, len(own) - 1, min(len(own), max(1, SAMPLES * len(part) // len(faces)))).astype(int)
        for centre, near in zip(picks, tree.query_ball_point(own[picks], AROUND * voxel), strict=True):
            if len(near) < 6:  # three points always lie in a plane
                continue
            around = own[near]
            middle = around.mean(axis=0)
            normal = np.linalg.svd(around - middle, full_matrices=False)[2][2]
            squares.append(float(((own[centre] - middle) @ normal / voxel) ** 2))
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


@njit(cache=True)
def _measured(triangles: Floats):  # pragma: no cover
    """Sides of triangles, shape (m, 3), and the smallest altitude of each, shape (m,)."""
    lengths, altitudes = np.empty((len(triangles), 3)), np.empty(len(triangles))
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        for side in range(3):
            p, q = triangles[t, side], triangles[t, side - 1]
            x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
            lengths[t, side] = np.sqrt(x * x + y * y + z * z)
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        altitudes[t] = np.sqrt(x * x + y * y + z * z) / max(lengths[t].max(), TINY)
    return lengths, altitudes


@njit(cache=True)
def _distances(triangles: Floats, original: Floats, source: Ints):  # pragma: no cover
    """Largest distance of each triangle's corners from its source."""
    found = np.zeros(len(triangles))
    for t in range(len(triangles)):
        for corner in range(3):
            p = triangles[t, corner]
            x, y, z = offset_from_triangle(p[0], p[1], p[2], original[source[t]])
            found[t] = max(found[t], np.sqrt(x * x + y * y + z * z))
    return found
