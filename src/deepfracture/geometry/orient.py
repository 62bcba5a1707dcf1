"""Makes neighbouring faces agree on which side is out."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.topology import neighbours
from deepfracture.types import Mesh


def oriented(mesh: Mesh) -> Mesh:
    """The mesh with neighbouring faces agreeing on their side, as far as the surface has two."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order

    one, other, agree = neighbours(mesh.faces)
    count = len(mesh.faces)
    graph = coo_array((np.where(agree, 1, 2), (one, other)), shape=(count, count)).tocsr()
    graph = (graph + graph.T).tocsr()
    flip, seen = np.zeros(count, bool), np.zeros(count, bool)
    against = set(zip(one[~agree].tolist(), other[~agree].tolist(), strict=True))
    for first in range(count):
        if seen[first]:
            continue
        order, before = breadth_first_order(graph, first, directed=False)
        seen[order] = True
        for face in order[1:].tolist():
            parent = int(before[face])
            turned = (parent, face) in against or (face, parent) in against
            flip[face] = flip[parent] ^ turned
    return Mesh(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces))
