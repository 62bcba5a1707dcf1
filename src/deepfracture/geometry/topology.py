"""How the triangles of a mesh hang together: welding, cleaning, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry.disjoint_sets import union
from deepfracture.types import BadInput, Ints, Mesh

WELD_TOL = 1e-6
"""Vertices closer than this share of the box diagonal are one: float32 noise of a transformed scene."""
MAX_PAIRS = 1 << 25
"""Vertices that close to each other, counted both ways, of which a table still fits into half a gigabyte."""


@dataclass(frozen=True)
class MeshDefects:
    """What keeps a mesh from being the surface of one solid. All zero: it is one."""

    boundary: int
    """Edges with one triangle."""
    non_manifold: int
    """Edges with three or more triangles."""
    flipped: int
    """Edges whose two triangles run the same way."""
    shells: int
    """Pieces that hang together by edges."""
    open_shells: int
    """Those of them with a boundary."""

    @property
    def closed(self) -> bool:
        """Every edge has two triangles that agree on the outside."""
        return not (self.boundary or self.non_manifold or self.flipped)

    def __str__(self) -> str:
        counts = (
            (self.open_shells, "open shell", "s"),
            (self.boundary, "boundary edge", "s"),
            (self.non_manifold, "edge", "s shared by more than two faces"),
            (self.flipped, "edge", "s between faces of opposite orientation"),
        )
        return ", ".join(f"{n} {what}{more if n > 1 else more[1:]}" for n, what, more in counts if n)


@njit(cache=True)
def radix_argsort(rows: Ints) -> Ints:  # pragma: no cover
    """The stable order in which rows of integers from 0 ascend, the first column first, shape (n,).

    By counting, in a time that grows with the number of rows and the greatest integer only."""
    order = np.arange(len(rows))
    for column in range(rows.shape[1] - 1, -1, -1):
        most = 0
        for n in range(len(rows)):
            most = max(most, rows[n, column])
        start = np.zeros(most + 2, np.int64)
        for n in range(len(rows)):
            start[rows[n, column] + 1] += 1
        start = np.cumsum(start)
        after = np.empty_like(order)
        for n in order:
            value = rows[n, column]
            after[start[value]] = n
            start[value] += 1
        order = after
    return order


@dataclass(frozen=True, eq=False)
class Edges:
    """The half edges of a mesh, three a face, and the undirected edges that they belong to."""

    ends: Ints
    """From and to, of each half edge, shape (3 m, 2)."""
    order: Ints
    """Half edges, those of one edge next to each other, shape (3 m,)."""
    edge: Ints
    """The edge that each half edge belongs to, shape (3 m,)."""
    counts: Ints
    """Half edges of each edge, shape (e,)."""

    @property
    def manifold(self) -> NDArray[np.bool_]:
        """Edges of two faces that agree on the outside, shape (e,)."""
        low, high = self.ends.T
        forward = np.bincount(self.edge, low < high, len(self.counts))
        return (self.counts == 2) & (forward == 1)

    @property
    def self_loops(self) -> NDArray[np.bool_]:
        """Edges from a vertex to itself, as faces with two equal corners have them, shape (e,)."""
        return np.bincount(self.edge, self.ends[:, 0] == self.ends[:, 1], len(self.counts)) > 0

    @property
    def twins(self) -> tuple[Ints, Ints]:
        """Half edges that follow each other in `order` on one edge: all pairs of those with two faces."""
        same = np.flatnonzero(self.edge[self.order[1:]] == self.edge[self.order[:-1]])
        return self.order[same], self.order[same + 1]


def edges_of(faces: Ints) -> Edges:
    """All edges of the faces, numbered in ascending order of their vertices."""
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    low, high = np.minimum(*ends.T), np.maximum(*ends.T)
    order = radix_argsort(np.column_stack([low, high]))
    low, high = low[order], high[order]
    new = np.ones(len(order), bool)
    new[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    which = np.empty(len(order), np.int64)
    which[order] = np.cumsum(new) - 1
    return Edges(ends, order, which, np.bincount(which))


@njit(cache=True)
def _components(count: int, one: Ints, other: Ints) -> Ints:  # pragma: no cover
    """The number 0.. of the connected part that each of `count` nodes belongs to, by the first node of each."""
    root = np.arange(count)
    for n in range(len(one)):
        union(root, one[n], other[n])
    found = 0
    for a in range(count):  # no root comes after what hangs on it
        if root[a] == a:
            root[a] = found
            found += 1
        else:
            root[a] = root[root[a]]
    return root


def shells(faces: Ints, edges: Edges | None = None) -> Ints:
    """The number 0.. of the edge-connected piece each face belongs to, shape (m,); `edges`: its own, if known."""
    one, other = (edges or edges_of(faces)).twins
    return _components(len(faces), one // 3, other // 3)


def mesh_defects(mesh: Mesh) -> MeshDefects:
    """What is wrong with the mesh as the surface of a solid."""
    edges = edges_of(mesh.faces)
    piece = shells(mesh.faces, edges)
    boundary = edges.counts[edges.edge] == 1
    opened = np.unique(np.repeat(piece, 3)[boundary])
    return MeshDefects(
        boundary=int((edges.counts == 1).sum()),
        non_manifold=int((edges.counts > 2).sum()),
        flipped=int(((edges.counts == 2) & ~edges.manifold).sum()),
        shells=int(piece.max(initial=-1)) + 1,
        open_shells=len(opened),
    )


def defective_vertices(mesh: Mesh) -> Ints:
    """Vertices of edges that do not have just two agreeing faces, ascending."""
    edges = edges_of(mesh.faces)
    return np.unique(edges.ends[~edges.manifold[edges.edge]])


def shell_volumes(mesh: Mesh, piece: Ints) -> NDArray[np.float64]:
    """Signed volume of each shell, shape (shells,)."""
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)
    parts = np.einsum("ni,ni->n", a, np.cross(b, c)) / 6
    return np.bincount(piece, weights=parts, minlength=int(piece.max(initial=-1)) + 1).astype(float)


def compact(vertices: NDArray, faces: Ints) -> Mesh:
    """The mesh without vertices that no face uses."""
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    return Mesh(np.asarray(vertices, float)[used], (np.cumsum(used) - 1)[faces])


def weld(vertices: NDArray, faces: Ints) -> Mesh:
    """One vertex a position, without degenerate or doubled faces or unused vertices."""
    from scipy.spatial import KDTree

    points, inverse = np.unique(np.asarray(vertices, float), axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[np.asarray(faces, np.int64)]
    tree, reach = KDTree(points), WELD_TOL * float(np.linalg.norm(np.ptp(points, axis=0)))
    if tree.count_neighbors(tree, reach) > MAX_PAIRS:
        raise BadInput(f"most of its vertices are one point next to its box of {reach / WELD_TOL:.0e}; is one far off?")
    pairs = tree.query_pairs(reach, output_type="ndarray")
    if len(pairs):
        label = _components(len(points), *pairs.T.astype(np.int64))
        keep = np.unique(label, return_index=True)[1]
        points, faces = points[keep], label[faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[keep]
    if not len(faces):
        raise BadInput("no triangle with an area")
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return compact(points, faces[np.sort(first)])


def fans(faces: Ints, edges: Edges | None = None) -> Ints:
    """The number 0.. of the fan of faces round a vertex that each corner belongs to, shape (m, 3); `edges`: their own,
    if known."""
    edges = edges or edges_of(faces)
    one, other = edges.twins
    after = np.arange(faces.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    # Corners of the two faces of an edge belong together, at each of its ends; a half edge starts at its own corner.
    flip = edges.ends[one, 0] != edges.ends[other, 0]
    starts, ends = np.where(flip, after[other], other), np.where(flip, other, after[other])
    return _components(faces.size, np.concatenate([one, after[one]]), np.concatenate([starts, ends])).reshape(-1, 3)


def split_pinches(mesh: Mesh) -> Mesh:
    """The mesh with every vertex where surface parts only touch in a point taken apart, so that
    the faces round each vertex form one fan."""
    fan = fans(mesh.faces)
    count = int(fan.max(initial=-1)) + 1
    if count == len(mesh.vertices):
        return mesh
    owner = np.zeros(count, np.int64)
    owner[fan] = mesh.faces
    return Mesh(mesh.vertices[owner], fan)


def adjacent_faces(faces: Ints) -> tuple[Ints, Ints, NDArray[np.bool_]]:
    """Pairs of faces across edges that exactly two share, and whether they agree on the outside."""
    edges = edges_of(faces)
    one, other = edges.order[edges.counts[edges.edge[edges.order]] == 2].reshape(-1, 2).T
    return one // 3, other // 3, edges.ends[one, 0] != edges.ends[other, 0]


def boundary_loops(faces: Ints) -> list[Ints]:
    """The holes of an oriented mesh without pinches, each as vertices in the order a cap uses them."""
    edges = edges_of(faces)
    rim = edges.ends[edges.counts[edges.edge] == 1][:, ::-1]
    after = {int(a): int(b) for a, b in rim}
    loops = []
    while after:
        start, vertex = after.popitem()
        loop = [start]
        while vertex != start and vertex in after:
            loop.append(vertex)
            vertex = after.pop(vertex)
        if vertex == start and len(loop) > 2:
            loops.append(np.array(loop))
    return loops
