"""Approximated centroidal Voronoi clusters of a closed triangle mesh (Valette and Chassery 2004), and their dual.

Seeds lie as far from each other as they can; each vertex joins the seed that is nearest along the edges. Then
vertices at the border between two clusters change sides wherever that lowers the energy

    sum over clusters of  sum w |x|^2 - |sum w x|^2 / sum w     (their eq. 4, w: a vertex's share of the area)

which is least for compact clusters of even size. No change may tear a cluster, or close it round a hole: where a
cluster starts as a disc it stays one. Nothing is drawn at random."""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numba import njit

from deepfracture.types import Floats, Ints, Mesh

SWEEPS = 200
"""Passes over all borders, at most; some thirty are enough as a rule."""
ROUNDS = 12
"""Times that clusters are parted, at most."""
LOCAL_SWEEPS = 8
"""Passes after each of them: neighbours make room, and all others stay as they are."""
MIN_GAIN = 1e-12
"""Gain of a change, as a share of the energy of a cluster's size, below which it is rounding."""


def cluster_vertices(mesh: Mesh, count: int) -> Ints:
    """The cluster of each vertex of a closed mesh whose vertices have one fan of faces each, shape (n,).

    Numbered from 0. There are `count` of them, or more where limbs are thinner than a cluster: those that go round a
    limb, or meet one other along two borders, are parted until the dual is a surface as the mesh is."""
    points = mesh.vertices - mesh.vertices.mean(axis=0)
    weights = _vertex_weights(mesh)
    points /= np.sqrt((weights[:, None] * points**2).sum())
    first, ring = vertex_rings(mesh.faces, len(points))
    label = np.zeros(len(points), np.int64)
    number = min(count, len(points))
    _seed(points, first, ring, label, np.arange(len(points)), np.arange(number))
    _minimise(points, weights, first, ring, label, np.ones(number, np.bool_), SWEEPS)
    for _ in range(ROUNDS):
        wrong = _irregular(mesh.faces, label, number)
        fresh = np.zeros(number + 2 * len(wrong), np.bool_)
        for cluster in wrong:
            members = np.flatnonzero(label == cluster)
            parts = min(3, len(members))
            _seed(points, first, ring, label, members, np.array([cluster, number, number + 1])[:parts])
            fresh[[cluster, *range(number, number + parts - 1)]] = True
            number += parts - 1
        if not fresh.any():
            break
        _minimise(points, weights, first, ring, label, fresh[:number], LOCAL_SWEEPS)
    return label


def dual_mesh(mesh: Mesh, label: Ints) -> Mesh:
    """One vertex a cluster, and a face wherever three clusters meet.

    From the middle of its area each vertex goes along the cluster's mean normal to where the planes of the faces are
    nearest (least squares, weighted by area): out to the edge that a cluster lies round. To follow their quadrics
    (Valette, Chassery and Prost 2008) sideways too would fit edges better, at the price of needles."""
    at = label[mesh.faces]
    a, b, c = at.T
    faces = at[(a != b) & (b != c) & (c != a)]
    weights = _vertex_weights(mesh)
    whole = np.bincount(label, weights)
    middle = np.column_stack([np.bincount(label, weights * x) / whole for x in mesh.vertices.T])
    normal = np.column_stack([sum(np.bincount(own, x, len(whole)) for own in at.T) for x in mesh.area_vectors.T])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    areas = np.linalg.norm(mesh.area_vectors, axis=1)
    rise, most = np.zeros(len(whole)), np.full(len(whole), 1e-300)
    for own in at.T:
        # How far above the middle each face's plane is, and how fast a move along the normal gets there.
        height = np.einsum("ni,ni->n", mesh.area_vectors, mesh.triangles[:, 0] - middle[own])
        slope = np.einsum("ni,ni->n", mesh.area_vectors, normal[own]) / np.maximum(areas, 1e-300)
        rise += np.bincount(own, height * slope, len(whole))
        most += np.bincount(own, areas * slope**2, len(whole))
    radius = np.sqrt(whole * areas.sum() / np.pi)
    return Mesh(middle + np.clip(rise / most, -radius, radius)[:, None] * normal, faces)


def _vertex_weights(mesh: Mesh) -> Floats:
    """The share of the area that belongs to each vertex."""
    areas = np.linalg.norm(mesh.area_vectors, axis=1)
    weights = np.bincount(mesh.faces.ravel(), np.repeat(areas / areas.sum() / 3, 3), len(mesh.vertices))
    # A vertex of slivers alone has no area of its own, but must belong somewhere.
    return np.maximum(weights, 1e-9 / len(weights))


def _irregular(faces: Ints, label: Ints, number: int) -> Ints:
    """Clusters that are no discs, or meet another along more than one border, or fewer than three others."""
    a, b, c = label[faces].T
    edges = np.stack([a == b, b == c, c == a])
    # Euler characteristic of what lies within each; two faces share an edge.
    round_ = np.bincount(label, minlength=number).astype(float)
    for same, x in zip(edges, (a, b, c), strict=True):
        round_ -= np.bincount(x[same], minlength=number) / 2
    round_ += np.bincount(a[edges.all(axis=0)], minlength=number)
    meet = label[faces][~edges.any(axis=0)]
    pairs = np.sort(meet[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    pairs, times = np.unique(pairs @ [number, 1], return_counts=True)
    crossed = np.stack(np.divmod(pairs[times != 2], number))
    wrong = (round_ != 1) | (np.bincount(meet.ravel(), minlength=number) < 3)
    wrong[crossed] = True
    return np.flatnonzero(wrong)


@njit(cache=True)
def vertex_rings(faces: Ints, count: int):  # pragma: no cover
    """The neighbours of each vertex in their order round it, as compressed rows: starts (count + 1,), neighbours."""
    first = np.zeros(count + 1, np.int64)
    for face in faces:
        for corner in face:
            first[corner + 1] += 1
    first = np.cumsum(first)
    filled = first[:-1].copy()
    ring, after = np.empty(first[-1], np.int64), np.empty(first[-1], np.int64)
    for face in faces:
        for k in range(3):
            v = face[k]
            ring[filled[v]], after[filled[v]] = face[(k + 1) % 3], face[(k + 2) % 3]
            filled[v] += 1
    for v in range(count):
        # Each spoke is followed by the one that ends its face.
        for s in range(first[v], first[v + 1] - 1):
            for t in range(s + 1, first[v + 1]):
                if ring[t] == after[s]:
                    ring[s + 1], ring[t] = ring[t], ring[s + 1]
                    after[s + 1], after[t] = after[t], after[s + 1]
                    break
    return first, ring


@njit(cache=True)
def _seed(points: Floats, first: Ints, ring: Ints, label: Ints, members: Ints, numbers: Ints):  # pragma: no cover
    """Give the vertices `members` new clusters: each seed is the vertex farthest from those before it, and takes all
    that are nearer to it along edges."""
    away = np.full(len(points), -1.0)
    away[members] = np.inf
    for n in numbers:
        seed = np.argmax(away)
        heap = [(0.0, seed)]
        away[seed], label[seed] = 0.0, n
        while len(heap) > 0:
            d, v = heappop(heap)
            if d > away[v] or label[v] != n:
                continue
            for s in range(first[v], first[v + 1]):
                u = ring[s]
                x, y, z = points[u] - points[v]
                there = d + np.sqrt(x * x + y * y + z * z)
                if there < away[u]:
                    away[u], label[u] = there, n
                    heappush(heap, (there, u))


@njit(cache=True)
def _minimise(
    points: Floats, weights: Floats, first: Ints, ring: Ints, label: Ints, fresh, sweeps: int
):  # pragma: no cover
    """Changes `label` until no change of one vertex is worth it, beginning at the borders of fresh clusters."""
    count = len(fresh)
    weight, sums = np.zeros(count), np.zeros((count, 3))
    for v in range(len(label)):
        weight[label[v]] += weights[v]
        sums[label[v]] += weights[v] * points[v]
    # The sweep in which each cluster last changed: a border between two that rest needs no look.
    touched = np.where(fresh, 0, -9)
    for sweep in range(1, sweeps + 1):
        changes = 0
        for v in range(len(label)):
            own = label[v]
            best, choice = MIN_GAIN / count, -1
            for s in range(first[v], first[v + 1]):
                other = label[ring[s]]
                if other in (own, choice) or max(touched[own], touched[other]) < sweep - 1:
                    continue
                gain = _gain(points[v], weights[v], sums, weight, own, other)
                if gain > best and _keeps_discs(label, first, ring, v, other):
                    best, choice = gain, other
            if choice >= 0:
                label[v] = choice
                weight[own] -= weights[v]
                weight[choice] += weights[v]
                sums[own] -= weights[v] * points[v]
                sums[choice] += weights[v] * points[v]
                touched[own] = touched[choice] = sweep
                changes += 1
        if changes == 0:
            break


@njit(cache=True)
def _gain(x: Floats, w: float, sums: Floats, weight: Floats, own: int, other: int):  # pragma: no cover
    """By how much the energy falls when a vertex x of weight w leaves cluster `own` for `other`."""
    if weight[own] - w <= 0:
        return -1.0
    before, after, before_other, after_other = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        before += sums[own, k] ** 2
        after += (sums[own, k] - w * x[k]) ** 2
        before_other += sums[other, k] ** 2
        after_other += (sums[other, k] + w * x[k]) ** 2
    return (
        after / (weight[own] - w)
        - before / weight[own]
        + after_other / (weight[other] + w)
        - before_other / weight[other]
    )


@njit(cache=True)
def _keeps_discs(label: Ints, first: Ints, ring: Ints, v: int, other: int):  # pragma: no cover
    """Whether v may join `other`: round v, its own cluster and the other must each be one run of neighbours."""
    own, runs_own, runs_other = label[v], 0, 0
    last = label[ring[first[v + 1] - 1]]
    for s in range(first[v], first[v + 1]):
        here = label[ring[s]]
        if here != last:
            runs_own += here == own
            runs_other += here == other
        last = here
    return runs_own == 1 and runs_other == 1
