"""Fewer triangles on the cracks, the same for both fragments at each, for games."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry import mass_properties
from deepfracture.geometry.intersect import self_intersections
from deepfracture.geometry.topology import compact
from deepfracture.types import BadInput, Floats, Fragment, Fragments, Ints, Mesh

Flags: TypeAlias = NDArray[np.bool_]

ROUNDS = 40
"""Rounds of collapses with disjoint neighbourhoods."""
FRACTION = 0.5
"""Of the vertices that could collapse, those that do in a round, the flattest first."""
MIN_ROTATION_COSINE = 0.2
"""Least cosine of the angle by which a collapse may rotate a face."""
MIN_QUALITY = 0.05
"""Quality of a triangle (1 equilateral, 0 sliver) that is always acceptable."""
MAX_VALENCE = 24
"""Faces at a vertex above which it stays."""
RETRIES = 4
"""Times that vertices of intersecting faces are restored; then whole fragments keep their cracks."""


@dataclass(frozen=True, eq=False)
class _CrackFaces:
    """All crack faces once, with vertices common to both sides, and the faces that touch them."""

    points: Floats
    """[m], shape (n, 3)."""
    faces: Ints
    """First the k crack faces, oriented as in the lower fragment, then the other faces at their points, shape (k + m,
    3)."""
    adjacent: Ints
    """The two fragments at each crack face, shape (k, 2)."""
    rows: Ints
    """Its number in the first and in the second fragment, shape (k, 2)."""
    local: Ints
    """Vertices in both fragments of the corners of each crack face, shape (k, 3, 2)."""
    fixed: Flags
    """Points that stay: on the boundary of a crack, or of several cracks, shape (n,)."""


def decimated(fragments: Fragments, max_faces: int) -> Fragments:
    """The same fragments with at most `max_faces` triangles each, as far as possible.

    Half-edge collapses by quadric error (Garland and Heckbert 1997) of vertices within the crack between two fragments,
    in both alike: neighbours still share their crack vertex for vertex, the outside stays as it is, the volumes still
    add up, and no surface comes to intersect itself. Where the outside and the boundaries of cracks alone have more
    triangles than `max_faces`, these remain.

    Raises:
        BadInput: `max_faces` is below 4.
    """
    if max_faces < 4:
        raise BadInput(f"max_faces must be at least 4 triangles a fragment, got {max_faces}")
    if all(len(piece.mesh.faces) <= max_faces for piece in fragments):
        return fragments
    cracks = _crack_faces(fragments)
    fixed, tries = cracks.fixed.copy(), 0
    while True:
        made, target = _decimate(fragments, cracks, fixed, max_faces)
        intersecting = _intersecting_points(fragments, made, cracks)
        if not intersecting.any():
            return made.fragments(fragments)
        tries += 1
        if tries <= RETRIES:
            fixed |= intersecting[target]
        else:  # every crack of a fragment that intersects itself
            bad = np.zeros(len(fragments.pieces), np.bool_)
            bad[made.adjacent[intersecting[made.faces].any(axis=1)]] = True
            fixed[cracks.faces[: len(cracks.adjacent)][bad[cracks.adjacent].any(axis=1)]] = True


@dataclass(frozen=True, eq=False)
class _Decimated:
    """The crack faces that are left after the collapses, fields as in `_CrackFaces`."""

    faces: Ints
    adjacent: Ints
    rows: Ints
    local: Ints
    paired: tuple[Flags, ...]
    """For each fragment, which of its faces are crack faces with an opposite face."""

    def pieces(self, fragments: Fragments, number: int) -> tuple[Ints, Ints]:
        """Faces of a fragment by its original vertices, and for each the crack face that it is, or -1."""
        piece, faces, names = fragments.pieces[number], [], []
        kept = np.flatnonzero(~self.paired[number])
        faces.append(piece.mesh.faces[kept])
        names.append(np.full(len(kept), -1))
        for side in (0, 1):
            here = np.flatnonzero(self.adjacent[:, side] == number)
            corners = self.local[here, :, side]
            faces.append(corners if side == 0 else corners[:, ::-1])
            names.append(here)
        return np.concatenate(faces), np.concatenate(names)

    def fragments(self, fragments: Fragments) -> Fragments:
        return Fragments(tuple(self._fragment(fragments, n) for n in range(len(fragments.pieces))))

    def _fragment(self, fragments: Fragments, number: int) -> Fragment:
        piece = fragments.pieces[number]
        faces, names = self.pieces(fragments, number)
        if len(faces) == len(piece.mesh.faces):
            return piece
        source = np.concatenate([piece.source[~self.paired[number]], np.full((names >= 0).sum(), -1)])
        mesh = compact(piece.mesh.vertices, faces)
        mass = mass_properties(mesh, piece.mass / piece.volume)
        return Fragment(mesh, source, mass.mass, mass.centre, mass.inertia)


def _crack_faces(fragments: Fragments) -> _CrackFaces:
    meshes = [piece.mesh for piece in fragments]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    shift = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    points, at = np.unique(vertices, axis=0, return_inverse=True)
    local = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, shift, strict=False)])
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    row = np.concatenate([np.arange(len(mesh.faces)) for mesh in meshes])
    faces = at.reshape(-1)[local].astype(np.int64)
    inner = np.concatenate([piece.source for piece in fragments]) < 0
    one, other = _opposite_faces(faces, owner, inner)
    turn = np.argmax(faces[other][:, None, :] == faces[one][:, :1, None], axis=2)  # where the first corner is
    corners = np.take_along_axis(local[other], (turn - np.arange(3)) % 3, axis=1)
    crack = np.zeros(len(faces), np.bool_)
    crack[one] = crack[other] = True
    rest = faces[~crack]
    fixed = np.zeros(len(points), np.bool_)
    fixed[rest] = True
    touching = np.zeros(len(points), np.bool_)
    touching[faces[one]] = True
    rest = rest[touching[rest].any(axis=1)]
    both = np.stack([local[one] - shift[owner[one]][:, None], corners - shift[owner[other]][:, None]], axis=2)
    return _CrackFaces(
        points, np.concatenate([faces[one], rest]), np.stack([owner[one], owner[other]], axis=1),
        np.stack([row[one], row[other]], axis=1), both, fixed,
    )  # fmt: skip


def _opposite_faces(faces: Ints, owner: Ints, inner: Flags) -> tuple[Ints, Ints]:
    """Crack faces that have exactly one mirror image, in another fragment; the lower fragment's first."""
    rows = np.flatnonzero(inner)
    corners = np.sort(faces[rows], axis=1)
    proper = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    rows, corners = rows[proper], corners[proper]
    _, key, times = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    key = key.reshape(-1)
    two = times[key] == 2
    order = rows[two][np.argsort(key[two], kind="stable")].reshape(-1, 2)
    one, other = order[:, 0], order[:, 1]
    distinct = owner[one] != owner[other]
    one, other = one[distinct], other[distinct]
    swap = owner[one] > owner[other]
    return np.where(swap, other, one), np.where(swap, one, other)


class _State(NamedTuple):
    """The crack faces during decimation, for kernels."""

    points: Floats
    faces: Ints
    """As in `_CrackFaces`, with collapsed points replaced."""
    adjacent: Ints
    local: Ints
    """As in `_CrackFaces`."""
    alive: Flags
    """Of each face."""
    size: Ints
    """Triangles of each fragment."""
    quadrics: Floats
    """Of each point, see `_quadrics`."""
    target: Ints
    """The point that each point has collapsed into, or itself."""
    dirty: Flags
    """Points whose faces have changed in the last round, or whose neighbours' have."""


class _Rings(NamedTuple):
    """The faces around each point."""

    first: Ints
    """Where those of each point start, and their number."""
    faces: Ints


def _decimate(fragments: Fragments, cracks: _CrackFaces, fixed: Flags, max_faces: int) -> tuple[_Decimated, Ints]:
    """The crack faces that are left, and for each point the one that it has collapsed into, or itself."""
    count = len(cracks.adjacent)
    state = _State(
        cracks.points, cracks.faces.copy(), cracks.adjacent, cracks.local.copy(), np.ones(len(cracks.faces), np.bool_),
        np.array([len(piece.mesh.faces) for piece in fragments]), _quadrics(cracks.points, cracks.faces[:count]),
        np.arange(len(cracks.points)), np.ones(len(cracks.points), np.bool_),
    )  # fmt: skip
    movable = ~fixed
    goal, cost = np.full(len(cracks.points), -1), np.full(len(cracks.points), np.inf)
    for _ in range(ROUNDS):
        live = np.flatnonzero(state.alive)
        corners = state.faces[live].ravel()
        corner = np.argsort(corners, kind="stable")
        rings = _Rings(np.searchsorted(corners[corner], np.arange(len(cracks.points) + 1)), live[corner // 3])
        _candidates(state, rings, movable, state.size > max_faces, goal, cost)
        found = np.flatnonzero(goal >= 0)
        if not len(found):
            break
        found = found[np.argsort(cost[found], kind="stable")][: max(1, int(FRACTION * len(found)))]
        _collapse(state, rings, found, goal, max_faces)
        if not state.dirty.any():
            break
        movable[found[state.target[found] != found]] = False
    target = state.target
    while (further := target[target]).tolist() != target.tolist():
        target = further
    left = np.flatnonzero(state.alive[:count])
    paired = []
    for number, piece in enumerate(fragments):
        flags = np.zeros(len(piece.mesh.faces), np.bool_)
        for side in (0, 1):
            flags[cracks.rows[cracks.adjacent[:, side] == number, side]] = True
        paired.append(flags)
    return _Decimated(
        state.faces[left], cracks.adjacent[left], cracks.rows[left], state.local[left], tuple(paired)
    ), target


def _intersecting_points(fragments: Fragments, made: _Decimated, cracks: _CrackFaces) -> Flags:
    """Points of crack faces that intersect another face of their fragment, as they did not before."""
    found = np.zeros(len(cracks.points), np.bool_)
    for number, piece in enumerate(fragments):
        faces, names = made.pieces(fragments, number)
        if len(faces) == len(piece.mesh.faces):
            continue
        pairs = names[self_intersections(Mesh(piece.mesh.vertices, faces))].ravel()
        found[made.faces[pairs[pairs >= 0]]] = True
    return found


@njit(cache=True)
def _quadrics(points: Floats, faces: Ints):  # pragma: no cover
    """Quadric error metrics: sum over the faces at each point of area times squared distance from their planes, as the
    10 coefficients of x^T A x + 2 b^T x + c, shape (n, 10)."""
    total = np.zeros((len(points), 10))
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        n = np.cross(b - a, c - a)
        double = np.sqrt((n * n).sum())
        if double == 0:
            continue
        n /= double
        d = -(n * a).sum()
        for corner in range(3):
            q = total[faces[f, corner]]
            slot = 0
            for i in range(3):
                for j in range(i, 3):
                    q[slot] += double * n[i] * n[j]
                    slot += 1
            for i in range(3):
                q[6 + i] += double * d * n[i]
            q[9] += double * d * d
    return total


@njit(cache=True)
def _error(q: Floats, p: Floats):  # pragma: no cover
    x, y, z = p
    square = q[0] * x * x + q[3] * y * y + q[5] * z * z + 2 * (q[1] * x * y + q[2] * x * z + q[4] * y * z)
    return square + 2 * (q[6] * x + q[7] * y + q[8] * z) + q[9]


@njit(cache=True)
def _candidates(state, rings, movable, too_large, goal, cost):  # pragma: no cover
    """For each point the neighbour that it had best collapse into, -1 if it must stay, and the cost: written where
    something has changed at the point or a neighbour."""
    points, adjacent, first = state.points, state.adjacent, rings.first
    seen, stamp = np.full(len(points), -1), 0
    ring, times = np.empty(MAX_VALENCE, np.int64), np.empty(MAX_VALENCE, np.int64)
    for v in range(len(points)):
        size = first[v + 1] - first[v]
        if not movable[v] or size < 3 or size > MAX_VALENCE:
            goal[v] = -1
            continue
        count, again, wanted = _one_ring(state.faces, rings, v, ring, times), False, False
        for k in range(count):
            again = again or state.dirty[ring[k]]
        if not (again or state.dirty[v]):
            continue
        goal[v], cost[v] = -1, np.inf
        for f in rings.faces[first[v] : first[v + 1]]:
            wanted = wanted or too_large[adjacent[f, 0]] or too_large[adjacent[f, 1]]
        creases = 0
        for k in range(count):
            creases += times[k] != 2
        if not wanted or (creases != 0 and creases != 2) or not _is_disk(state.faces, adjacent, rings, v):
            continue
        for k in range(count):
            u = ring[k]
            if creases and (times[k] == 2 or not _joins_all(state.faces, adjacent, rings, v, u)):
                continue
            stamp += 1
            for j in range(count):
                seen[ring[j]] = stamp
            common = 0
            for f in rings.faces[first[u] : first[u + 1]]:
                for n in range(3):
                    w = state.faces[f, n]
                    if w != u and seen[w] == stamp:
                        seen[w] = -1
                        common += 1
            if common != times[k]:  # the link condition: another edge or face joins them already
                continue
            error = _error(state.quadrics[v], points[u])
            if error < cost[v] and _keeps_shape(points, state.faces, rings, v, u):
                goal[v], cost[v] = u, error


@njit(cache=True)
def _one_ring(faces, rings, v, ring, times):  # pragma: no cover
    """The points joined to v by edges, and the faces at each of these edges; returns how many, MAX_VALENCE at most."""
    at, first = rings.faces, rings.first
    count = 0
    for s in range(first[v], first[v + 1]):
        for n in range(3):
            w = faces[at[s], n]
            if w == v:
                continue
            k = 0
            while k < count and ring[k] != w:
                k += 1
            if k == count:
                if count == len(ring):
                    return count
                ring[k], times[k] = w, 0
                count += 1
            times[k] += 1
    return count


@njit(cache=True)
def _joins_all(faces, adjacent, rings, v, u):  # pragma: no cover
    """Whether every fragment at v is at the edge from v to u, too."""
    at, first = rings.faces, rings.first
    for s in range(first[v], first[v + 1]):
        for side in range(2):
            found = False
            for t in range(first[v], first[v + 1]):
                f, number = at[t], adjacent[at[s], side]
                at_edge = faces[f, 0] == u or faces[f, 1] == u or faces[f, 2] == u
                found = found or (at_edge and (adjacent[f, 0] == number or adjacent[f, 1] == number))
            if not found:
                return False
    return True


@njit(cache=True)
def _is_disk(faces, adjacent, rings, v):  # pragma: no cover
    """Whether the faces at v are crack faces alone, and those of each fragment one closed fan."""
    at, first = rings.faces, rings.first
    for s in range(first[v], first[v + 1]):
        if at[s] >= len(adjacent):
            return False
    for s in range(first[v], first[v + 1]):
        for side in range(2):
            number, size, steps, seen = adjacent[at[s], side], 0, 0, False
            for t in range(first[v], first[v + 1]):
                own = adjacent[at[t], 0] == number or adjacent[at[t], 1] == number
                size += own
                seen = seen or (own and t < s)
            if seen:
                continue
            start, here = _opposite_edge(faces, at[s], v, side)
            while True:
                following, found = -1, 0
                for t in range(first[v], first[v + 1]):
                    for other in range(2):
                        if adjacent[at[t], other] == number:
                            a, b = _opposite_edge(faces, at[t], v, other)
                            if a == here:
                                following = b
                                found += 1
                steps += 1
                if found != 1 or steps > size:
                    return False
                if here == start:
                    break
                here = following
            if steps != size:
                return False
    return True


@njit(cache=True, inline="always")
def _opposite_edge(faces, f, v, side):  # pragma: no cover
    """The edge of a face opposite v, oriented as in the fragment on that side."""
    n = 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2
    a, b = faces[f, (n + 1) % 3], faces[f, (n + 2) % 3]
    return (a, b) if side == 0 else (b, a)


@njit(cache=True)
def _keeps_shape(points, faces, rings, v, u):  # pragma: no cover
    """Whether the faces at v keep their orientation and quality once v has collapsed into u."""
    at, first = rings.faces, rings.first
    for s in range(first[v], first[v + 1]):
        a, b, c = faces[at[s], 0], faces[at[s], 1], faces[at[s], 2]
        if a == u or b == u or c == u:
            continue
        x, y, z, old_quality = _area_and_quality(points[a], points[b], points[c])
        nx, ny, nz, quality = _area_and_quality(
            points[u if a == v else a], points[u if b == v else b], points[u if c == v else c]
        )
        dot, old_square, new_square = x * nx + y * ny + z * nz, x * x + y * y + z * z, nx * nx + ny * ny + nz * nz
        if quality < min(MIN_QUALITY, old_quality) or dot <= MIN_ROTATION_COSINE * np.sqrt(old_square * new_square):
            return False
    return True


@njit(cache=True, inline="always")
def _area_and_quality(a, b, c):  # pragma: no cover
    """Twice the area vector of a triangle, and its quality: 1 if equilateral, 0 for a sliver."""
    ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    squares = ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz + wx * wx + wy * wy + wz * wz
    quality = 2 * np.sqrt(3.0) * np.sqrt(x * x + y * y + z * z) / squares if squares > 0 else 0.0
    return x, y, z, quality


@njit(cache=True)
def _collapse(state, rings, order, goal, max_faces):  # pragma: no cover
    """Collapse in this order, as long as an adjacent fragment has too many faces; marks what has changed `dirty`."""
    faces, adjacent, size, dirty = state.faces, state.adjacent, state.size, state.dirty
    dirty[:] = False
    for v in order:
        u = goal[v]
        own = rings.faces[rings.first[v] : rings.first[v + 1]]
        free, wanted = True, False
        for f in own:
            wanted = wanted or size[adjacent[f, 0]] > max_faces or size[adjacent[f, 1]] > max_faces
            for w in faces[f]:
                free = free and not dirty[w]
        if not (free and wanted):
            continue
        for f in own:
            for w in faces[f]:
                dirty[w] = True
        for f in own:
            if faces[f, 0] == u or faces[f, 1] == u or faces[f, 2] == u:
                state.alive[f] = False
                size[adjacent[f, 0]] -= 1
                size[adjacent[f, 1]] -= 1
                continue
            for n in range(3):
                if faces[f, n] == v:
                    faces[f, n] = u
                    for side in range(2):
                        state.local[f, n, side] = _local_vertex(state, own, v, u, adjacent[f, side])
        state.quadrics[u] += state.quadrics[v]
        state.target[v] = u


@njit(cache=True)
def _local_vertex(state, own, v, u, number):  # pragma: no cover
    """The vertex of a fragment at the point u, by the edge from v, whose faces are `own`."""
    faces = state.faces
    for f in own:
        for n in range(3):
            if faces[f, n] == u and (faces[f, (n + 1) % 3] == v or faces[f, (n + 2) % 3] == v):
                for side in range(2):
                    if state.adjacent[f, side] == number:
                        return state.local[f, n, side]
    return -1
