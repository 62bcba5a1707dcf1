"""Disjoint-set forest (union-find) for compiled code: `parent[n]` is the parent of node n, n itself at a root."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def find(parent: np.ndarray, node: int) -> int:
    """The root of a node, with path halving (Tarjan and van Leeuwen 1984)."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True, inline="always")
def union(parent: np.ndarray, one: int, other: int) -> bool:
    """Merge the sets of two nodes, if they differ; the lower root stays. Whether they differed."""
    merged = False
    if parent[one] != parent[other]:
        a, b = find(parent, one), find(parent, other)
        merged = a != b
        parent[max(a, b)] = min(a, b)
    return merged


@njit(cache=True)
def flatten(parent: np.ndarray) -> None:  # pragma: no cover
    """Point each node at its root. Roots are the lowest nodes of their sets, as `union` leaves them."""
    for n in range(len(parent)):
        parent[n] = parent[parent[n]]
