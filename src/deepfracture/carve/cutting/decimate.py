"""Fewer triangles on the cracks, the same for both fragments beside each: a budget for games."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry import mass_properties
from deepfracture.geometry.intersect import self_intersections
from deepfracture.geometry.topology import compact
from deepfracture.types import BadInput, Floats, Fragment, Fragments, Ints, Mesh

Flags: TypeAlias = NDArray[np.bool_]

ROUNDS = 40
"""Of collapses whose neighbourhoods do not touch."""
SHARE = 0.5
"""Of the vertices that could go, those that go in a round, the flattest first."""
TURN = 0.2
"""Least cosine of the angle by which a collapse may turn a face."""
SHAPE = 0.05
"""Shape of a triangle (1 equilateral, 0 sliver) that a collapse may always make."""
RING = 24
"""Faces at a vertex above which it stays."""
MENDING = 4
"""Times that vertices beside crossing faces are put back; then whole fragments keep their cracks as they were."""


@dataclass(frozen=True, eq=False)
class _Cracks:
    """All cracks once, their vertices common to both sides, and what touches them."""

    points: Floats
    """[m], shape (n, 3)."""
    faces: Ints
    """First the k crack faces, as the lower fragment has them, then what else is at their points, shape (k + m, 3)."""
    beside: Ints
    """The two fragments beside each crack face, shape (k, 2)."""
    rows: Ints
    """Its number in the first and in the second fragment, shape (k, 2)."""
    own: Ints
    """Vertices in both fragments of the corners of each crack face, shape (k, 3, 2)."""
    fixed: Flags
    """Points that stay: on the rim of a crack, or of several cracks, shape (n,)."""


def coarsened(fragments: Fragments, most: int) -> Fragments:
    """The same fragments with at most `most` triangles each, as far as that can be had.

    Only vertices within the crack between two fragments go, the flattest first (quadric error of half-edge collapses,
    Garland & Heckbert 1997), and from both sides alike: neighbours still share their crack vertex for vertex, the
    outside stays as it is, the volumes still add up, and no surface comes to cross itself. Where the outside and the
    rims alone are more than the budget, those are left.

    Raises:
        BadInput: `most` is below 4.
    """
    if most < 4:
        raise BadInput(f"a budget must be at least 4 triangles a fragment, got {most}")
    if all(len(piece.mesh.faces) <= most for piece in fragments):
        return fragments
    cracks = _cracks_of(fragments)
    fixed, tries = cracks.fixed.copy(), 0
    while True:
        made, into = _collapsed(fragments, cracks, fixed, most)
        crossing = _crossing_points(fragments, made, cracks)
        if not crossing.any():
            return made.fragments(fragments)
        tries += 1
        if tries <= MENDING:
            fixed |= crossing[into]
        else:  # every crack of a fragment that crosses itself
            bad = np.zeros(len(fragments.pieces), np.bool_)
            bad[made.beside[crossing[made.faces].any(axis=1)]] = True
            fixed[cracks.faces[: len(cracks.beside)][bad[cracks.beside].any(axis=1)]] = True


@dataclass(frozen=True, eq=False)
class _Coarse:
    """Crack faces after the collapses: those that are left, as in `_Cracks`."""

    faces: Ints
    beside: Ints
    rows: Ints
    own: Ints
    matched: tuple[Flags, ...]
    """For each fragment, which of its faces are crack faces that have a mate."""

    def pieces(self, fragments: Fragments, number: int) -> tuple[Ints, Ints]:
        """Faces of a fragment by its old vertices, and for each the crack face that it is, or -1."""
        piece, faces, names = fragments.pieces[number], [], []
        kept = np.flatnonzero(~self.matched[number])
        faces.append(piece.mesh.faces[kept])
        names.append(np.full(len(kept), -1))
        for side in (0, 1):
            here = np.flatnonzero(self.beside[:, side] == number)
            corners = self.own[here, :, side]
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
        source = np.concatenate([piece.source[~self.matched[number]], np.full((names >= 0).sum(), -1)])
        mesh = compact(piece.mesh.vertices, faces)
        mass = mass_properties(mesh, piece.mass / piece.volume)
        return Fragment(mesh, source, mass.mass, mass.centre, mass.inertia)


def _cracks_of(fragments: Fragments) -> _Cracks:
    meshes = [piece.mesh for piece in fragments]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    shift = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    points, at = np.unique(vertices, axis=0, return_inverse=True)
    own = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, shift, strict=False)])
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    row = np.concatenate([np.arange(len(mesh.faces)) for mesh in meshes])
    faces = at.reshape(-1)[own].astype(np.int64)
    inner = np.concatenate([piece.source for piece in fragments]) < 0
    one, other = _mates(faces, owner, inner)
    turn = np.argmax(faces[other][:, None, :] == faces[one][:, :1, None], axis=2)  # where the first corner is
    corners = np.take_along_axis(own[other], (turn - np.arange(3)) % 3, axis=1)
    crack = np.zeros(len(faces), np.bool_)
    crack[one] = crack[other] = True
    rest = faces[~crack]
    fixed = np.zeros(len(points), np.bool_)
    fixed[rest] = True
    touching = np.zeros(len(points), np.bool_)
    touching[faces[one]] = True
    rest = rest[touching[rest].any(axis=1)]
    both = np.stack([own[one] - shift[owner[one]][:, None], corners - shift[owner[other]][:, None]], axis=2)
    return _Cracks(
        points, np.concatenate([faces[one], rest]), np.stack([owner[one], owner[other]], axis=1),
        np.stack([row[one], row[other]], axis=1), both, fixed,
    )  # fmt: skip


def _mates(faces: Ints, owner: Ints, inner: Flags) -> tuple[Ints, Ints]:
    """Crack faces that have exactly one mirror image, in another fragment; the lower fragment's first."""
    rows = np.flatnonzero(inner)
    corners = np.sort(faces[rows], axis=1)
    plain = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    rows, corners = rows[plain], corners[plain]
    _, key, times = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    key = key.reshape(-1)
    two = times[key] == 2
    order = rows[two][np.argsort(key[two], kind="stable")].reshape(-1, 2)
    one, other = order[:, 0], order[:, 1]
    apart = owner[one] != owner[other]
    one, other = one[apart], other[apart]
    swap = owner[one] > owner[other]
    return np.where(swap, other, one), np.where(swap, one, other)


def _collapsed(fragments: Fragments, cracks: _Cracks, fixed: Flags, most: int) -> tuple[_Coarse, Ints]:
    """The crack faces that are left, and for each point the one that it has gone into, or itself."""
    count = len(cracks.beside)
    faces, own = cracks.faces.copy(), cracks.own.copy()
    alive, into = np.ones(len(faces), np.bool_), np.arange(len(cracks.points))
    size = np.array([len(piece.mesh.faces) for piece in fragments])
    quadrics = _quadrics(cracks.points, faces[:count])
    loose = ~fixed
    goal, cost = np.full(len(cracks.points), -1), np.full(len(cracks.points), np.inf)
    changed = np.ones(len(cracks.points), np.bool_)
    for _ in range(ROUNDS):
        live = np.flatnonzero(alive)
        corner = np.argsort(faces[live].ravel(), kind="stable")
        at = live[corner // 3]
        first = np.searchsorted(faces[live].ravel()[corner], np.arange(len(cracks.points) + 1))
        over = size > most
        _candidates(cracks.points, faces, at, first, cracks.beside, loose, over, changed, quadrics, goal, cost)
        found = np.flatnonzero(goal >= 0)
        if not len(found):
            break
        found = found[np.argsort(cost[found], kind="stable")][: max(1, int(SHARE * len(found)))]
        _apply(found, goal, faces, own, at, first, alive, cracks.beside, size, most, quadrics, into, changed)
        if not changed.any():
            break
        loose[found[into[found] != found]] = False
    while (further := into[into]).tolist() != into.tolist():
        into = further
    left = np.flatnonzero(alive[:count])
    matched = []
    for number, piece in enumerate(fragments):
        flags = np.zeros(len(piece.mesh.faces), np.bool_)
        for side in (0, 1):
            flags[cracks.rows[cracks.beside[:, side] == number, side]] = True
        matched.append(flags)
    return _Coarse(faces[left], cracks.beside[left], cracks.rows[left], own[left], tuple(matched)), into


def _crossing_points(fragments: Fragments, made: _Coarse, cracks: _Cracks) -> Flags:
    """Points of crack faces that cross another face of their fragment, as they did not before."""
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
    """Sum over the faces at each point of area times squared distance from their planes, as the 10 coefficients of
    x^T A x + 2 b^T x + c, shape (n, 10)."""
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
def _candidates(points, faces, at, first, beside, loose, over, changed, quadrics, goal, cost):  # pragma: no cover
    """For each point the neighbour that it had best go into, -1 if it must stay, and what that costs: written where
    something has changed at the point or beside it."""
    seen, stamp = np.full(len(points), -1), 0
    around, times = np.empty(RING, np.int64), np.empty(RING, np.int64)
    for v in range(len(points)):
        size = first[v + 1] - first[v]
        if not loose[v] or size < 3 or size > RING:
            goal[v] = -1
            continue
        count, again, over_here = _neighbours(faces, at, first, v, around, times), False, False
        for k in range(count):
            again = again or changed[around[k]]
        if not (again or changed[v]):
            continue
        goal[v], cost[v] = -1, np.inf
        for s in range(first[v], first[v + 1]):
            over_here = over_here or over[beside[at[s], 0]] or over[beside[at[s], 1]]
        creases = 0
        for k in range(count):
            creases += times[k] != 2
        if not over_here or (creases != 0 and creases != 2) or not _disks(faces, at, first, beside, v):
            continue
        for k in range(count):
            u = around[k]
            if creases and (times[k] == 2 or not _whole_edge(faces, at, first, beside, v, u)):
                continue
            stamp += 1
            for j in range(count):
                seen[around[j]] = stamp
            common = 0
            for s in range(first[u], first[u + 1]):
                for n in range(3):
                    w = faces[at[s], n]
                    if w != u and seen[w] == stamp:
                        seen[w] = -1
                        common += 1
            if common != times[k]:  # the link condition: another edge or face joins them already
                continue
            error = _error(quadrics[v], points[u])
            if error < cost[v] and _fine(points, faces, at, first, v, u):
                goal[v], cost[v] = u, error


@njit(cache=True)
def _neighbours(faces, at, first, v, around, times):  # pragma: no cover
    """The points that edges join to v, and the faces at each of these edges; how many, at most RING are kept."""
    count = 0
    for s in range(first[v], first[v + 1]):
        for n in range(3):
            w = faces[at[s], n]
            if w == v:
                continue
            k = 0
            while k < count and around[k] != w:
                k += 1
            if k == count:
                if count == len(around):
                    return count
                around[k], times[k] = w, 0
                count += 1
            times[k] += 1
    return count


@njit(cache=True)
def _whole_edge(faces, at, first, beside, v, u):  # pragma: no cover
    """Whether every fragment at v is at the edge from v to u too."""
    for s in range(first[v], first[v + 1]):
        for side in range(2):
            found = False
            for t in range(first[v], first[v + 1]):
                f, number = at[t], beside[at[s], side]
                at_edge = faces[f, 0] == u or faces[f, 1] == u or faces[f, 2] == u
                found = found or (at_edge and (beside[f, 0] == number or beside[f, 1] == number))
            if not found:
                return False
    return True


@njit(cache=True)
def _disks(faces, at, first, beside, v):  # pragma: no cover
    """Whether the faces at v are crack faces alone, and those of each fragment one closed fan."""
    for s in range(first[v], first[v + 1]):
        if at[s] >= len(beside):
            return False
    for s in range(first[v], first[v + 1]):
        for side in range(2):
            number, size, steps, seen = beside[at[s], side], 0, 0, False
            for t in range(first[v], first[v + 1]):
                own = beside[at[t], 0] == number or beside[at[t], 1] == number
                size += own
                seen = seen or (own and t < s)
            if seen:
                continue
            start, here = _rim(faces, at[s], v, side)
            while True:
                following, found = -1, 0
                for t in range(first[v], first[v + 1]):
                    for other in range(2):
                        if beside[at[t], other] == number:
                            a, b = _rim(faces, at[t], v, other)
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
def _rim(faces, f, v, side):  # pragma: no cover
    """The edge of a face opposite v, in the sense of the fragment on that side."""
    n = 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2
    a, b = faces[f, (n + 1) % 3], faces[f, (n + 2) % 3]
    return (a, b) if side == 0 else (b, a)


@njit(cache=True)
def _fine(points, faces, at, first, v, u):  # pragma: no cover
    """Whether the faces at v keep their sense and a shape once v has gone into u."""
    for s in range(first[v], first[v + 1]):
        a, b, c = faces[at[s], 0], faces[at[s], 1], faces[at[s], 2]
        if a == u or b == u or c == u:
            continue
        x, y, z, before = _facing(points[a], points[b], points[c])
        nx, ny, nz, now = _facing(points[u if a == v else a], points[u if b == v else b], points[u if c == v else c])
        along, square, new = x * nx + y * ny + z * nz, x * x + y * y + z * z, nx * nx + ny * ny + nz * nz
        if now < min(SHAPE, before) or along <= TURN * np.sqrt(square * new):
            return False
    return True


@njit(cache=True, inline="always")
def _facing(a, b, c):  # pragma: no cover
    """Twice the area vector of a triangle, and its shape: 1 if equilateral, 0 for a sliver."""
    ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    squares = ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz + wx * wx + wy * wy + wz * wz
    shape = 2 * np.sqrt(3.0) * np.sqrt(x * x + y * y + z * z) / squares if squares > 0 else 0.0
    return x, y, z, shape


@njit(cache=True)
def _apply(order, goal, faces, own, at, first, alive, beside, size, most, quadrics, into, changed):  # pragma: no cover
    """Collapse in this order, as long as a fragment beside is over the budget; marks what has `changed`."""
    changed[:] = False
    for v in order:
        u = goal[v]
        free, wanted = True, False
        for s in range(first[v], first[v + 1]):
            wanted = wanted or size[beside[at[s], 0]] > most or size[beside[at[s], 1]] > most
            for w in faces[at[s]]:
                free = free and not changed[w]
        if not (free and wanted):
            continue
        for s in range(first[v], first[v + 1]):
            for w in faces[at[s]]:
                changed[w] = True
        for s in range(first[v], first[v + 1]):
            f = at[s]
            if faces[f, 0] == u or faces[f, 1] == u or faces[f, 2] == u:
                alive[f] = False
                size[beside[f, 0]] -= 1
                size[beside[f, 1]] -= 1
                continue
            for n in range(3):
                if faces[f, n] == v:
                    faces[f, n] = u
                    for side in range(2):
                        own[f, n, side] = _corner(faces, own, at, first, beside, v, u, beside[f, side])
        quadrics[u] += quadrics[v]
        into[v] = u


@njit(cache=True)
def _corner(faces, own, at, first, beside, v, u, number):  # pragma: no cover
    """What a fragment calls the point u, at the edge from v."""
    for s in range(first[v], first[v + 1]):
        f = at[s]
        for n in range(3):
            if faces[f, n] == u and (faces[f, (n + 1) % 3] == v or faces[f, (n + 2) % 3] == v):
                for side in range(2):
                    if beside[f, side] == number:
                        return own[f, n, side]
    return -1
