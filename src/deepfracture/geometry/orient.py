"""Makes neighbouring faces agree on which side is out."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.topology import adjacent_faces
from deepfracture.types import Mesh


def orient(mesh: Mesh) -> Mesh:
    """The mesh with neighbouring faces agreeing on their side, as far as the surface has two."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    one, other, agree = adjacent_faces(mesh.faces)
    count = len(mesh.faces)
    links = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(count, count))
    _, part = connected_components(links, directed=False)
    _, first = np.unique(part, return_index=True)
    # One more node, beside the first face of every part, makes them a tree: one walk instead of one for each.
    one_more, other_more = np.concatenate([one, np.full(len(first), count)]), np.concatenate([other, first])
    links = coo_array((np.ones(len(one_more), np.int8), (one_more, other_more)), shape=(count + 1, count + 1))
    order, before = breadth_first_order(links.tocsr(), count, directed=False)
    flip = np.zeros(count + 1, bool)
    against = set(zip(one[~agree].tolist(), other[~agree].tolist(), strict=True))
    for face in order[1:].tolist():
        parent = int(before[face])
        turned = (parent, face) in against or (face, parent) in against
        flip[face] = flip[parent] ^ turned
    return Mesh(mesh.vertices, np.where(flip[:count, None], mesh.faces[:, ::-1], mesh.faces))
