"""How the triangles of a mesh hang together: welding, cleaning, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepfracture.types import BadInput, Ints, Mesh

WELD = 1e-6
"""Vertices closer than this share of the box diagonal are one: float32 noise of a transformed scene."""
PAIRS = 1 << 25
"""Vertices that close to each other, counted both ways, of which a table still fits into half a gigabyte."""


@dataclass(frozen=True)
class Faults:
    """What keeps a mesh from being the surface of one solid. All zero: it is one."""

    boundary: int
    """Edges with one triangle."""
    crowded: int
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
        return not (self.boundary or self.crowded or self.flipped)

    def __str__(self) -> str:
        counts = (
            (self.open_shells, "open shell", "s"),
            (self.boundary, "boundary edge", "s"),
            (self.crowded, "edge", "s shared by more than two faces"),
            (self.flipped, "edge", "s between faces of opposite orientation"),
        )
        return ", ".join(f"{n} {what}{more if n > 1 else more[1:]}" for n, what, more in counts if n)


def _half_edges(faces: Ints) -> Ints:
    """Directed edges face by face, shape (3 m, 2)."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def _undirected(edges: Ints) -> tuple[Ints, Ints]:
    """The index of the undirected edge each half edge belongs to, and how many share it."""
    ordered = np.sort(edges, axis=1)
    _, which, counts = np.unique(ordered @ [1 + int(edges.max(initial=0)), 1], return_inverse=True, return_counts=True)
    return which, counts


def shells(faces: Ints) -> Ints:
    """The number 0.. of the edge-connected piece each face belongs to, shape (m,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    which, counts = _undirected(_half_edges(faces))
    owner = np.arange(3 * len(faces)) // 3
    # Faces and edges are the two sides of one graph.
    size = len(faces) + len(counts)
    graph = coo_array((np.ones(len(which), np.int8), (owner, len(faces) + which)), shape=(size, size))
    labels = connected_components(graph, directed=False)[1][: len(faces)]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def faults(mesh: Mesh) -> Faults:
    """What is wrong with the mesh as the surface of a solid."""
    edges = _half_edges(mesh.faces)
    which, counts = _undirected(edges)
    forward = np.bincount(which, weights=np.where(edges[:, 0] < edges[:, 1], 1, -1), minlength=len(counts))
    piece = shells(mesh.faces)
    boundary = counts[which] == 1
    opened = np.unique(np.repeat(piece, 3)[boundary])
    return Faults(
        boundary=int((counts == 1).sum()),
        crowded=int((counts > 2).sum()),
        flipped=int(((counts == 2) & (forward != 0)).sum()),
        shells=int(piece.max(initial=-1)) + 1,
        open_shells=len(opened),
    )


def torn_vertices(mesh: Mesh) -> Ints:
    """Vertices of edges that do not have just two agreeing faces, ascending."""
    edges = _half_edges(mesh.faces)
    which, counts = _undirected(edges)
    forward = np.bincount(which, weights=np.where(edges[:, 0] < edges[:, 1], 1, -1), minlength=len(counts))
    return np.unique(edges[(counts[which] != 2) | (forward[which] != 0)])


def shell_volumes(mesh: Mesh, piece: Ints) -> NDArray[np.float64]:
    """Signed volume of each shell, shape (shells,)."""
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)
    parts = np.einsum("ni,ni->n", a, np.cross(b, c)) / 6
    return np.bincount(piece, weights=parts, minlength=int(piece.max(initial=-1)) + 1).astype(float)


def compact(vertices: NDArray, faces: Ints) -> Mesh:
    """The mesh without vertices that no face uses."""
    used, inverse = np.unique(faces, return_inverse=True)
    return Mesh(np.asarray(vertices, float)[used], inverse.reshape(-1, 3))


def weld(vertices: NDArray, faces: Ints) -> Mesh:
    """One vertex a position, without degenerate or doubled faces or unused vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    points, inverse = np.unique(np.asarray(vertices, float), axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[np.asarray(faces, np.int64)]
    tree, reach = KDTree(points), WELD * float(np.linalg.norm(np.ptp(points, axis=0)))
    if tree.count_neighbors(tree, reach) > PAIRS:
        raise BadInput(f"most of its vertices are one point next to its box of {reach / WELD:.0e}; is one far off?")
    pairs = tree.query_pairs(reach, output_type="ndarray")
    if len(pairs):
        graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
        label = connected_components(graph, directed=False)[1]
        keep = np.unique(label, return_index=True)[1]
        points, faces = points[keep], label[faces].astype(np.int64)
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[keep]
    if not len(faces):
        raise BadInput("no triangle with an area")
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return compact(points, faces[np.sort(first)])


def split_pinches(mesh: Mesh) -> Mesh:
    """The mesh with every vertex where surface parts only touch in a point taken apart, so that
    the faces round each vertex form one fan."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    faces = mesh.faces
    corner_of = np.arange(faces.size).reshape(-1, 3)
    edges = _half_edges(faces)
    # Corners of the two faces of an edge belong together, at each of its ends.
    starts, ends = corner_of[:, [0, 1, 2]].ravel(), corner_of[:, [1, 2, 0]].ravel()
    which, _ = _undirected(edges)
    order = np.argsort(which, kind="stable")
    same = which[order][1:] == which[order][:-1]
    one, other = order[:-1][same], order[1:][same]
    flip = edges[one, 0] != edges[other, 0]
    rows = np.concatenate([starts[one], ends[one]])
    columns = np.concatenate([np.where(flip, ends[other], starts[other]), np.where(flip, starts[other], ends[other])])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(faces.size,) * 2)
    count, fan = connected_components(graph, directed=False)
    if count == len(mesh.vertices):
        return mesh
    owner = np.zeros(count, np.int64)
    owner[fan] = faces.ravel()
    return Mesh(mesh.vertices[owner], fan.reshape(-1, 3).astype(np.int64))


def neighbours(faces: Ints) -> tuple[Ints, Ints, NDArray[np.bool_]]:
    """Pairs of faces across edges that exactly two share, and whether they agree on the outside."""
    edges = _half_edges(faces)
    which, counts = _undirected(edges)
    order = np.argsort(which, kind="stable")
    order = order[counts[which[order]] == 2].reshape(-1, 2)
    agree = edges[order[:, 0], 0] != edges[order[:, 1], 0]
    return order[:, 0] // 3, order[:, 1] // 3, agree


def boundary_loops(faces: Ints) -> list[Ints]:
    """The holes of an oriented mesh without pinches, each as vertices in the order a cap uses them."""
    edges = _half_edges(faces)
    which, counts = _undirected(edges)
    rim = edges[counts[which] == 1][:, ::-1]
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
