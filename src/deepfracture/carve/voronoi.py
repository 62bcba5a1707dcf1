"""Voronoi cells as fracture patterns."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from deepfracture.geometry.oriented_points import FAR
from deepfracture.types import BadInput, FracturePattern, Grid
from deepfracture.voxels import connected_labels


def voronoi_pattern(sites: ArrayLike, inside: ArrayLike, grid: Grid) -> FracturePattern:
    """Voronoi cells of `sites` inside a body, with exact distances to their walls.

    A cell that the body cuts into several connected parts gives one label for each.

    Args:
        sites: Distinct points [m], body frame, shape (n, 3).
        inside: Whether a voxel's centre lies in the body, bool, shape (r, r, r).
        grid: Voxels to fill.

    Raises:
        BadInput: Wrong shapes, or two sites at one place.
    """
    sites = np.ascontiguousarray(sites, float)
    within = np.ascontiguousarray(inside)
    if sites.ndim != 2 or sites.shape[1] != 3 or len(sites) == 0:
        raise BadInput(f"sites must have shape (n, 3) with n > 0, got {sites.shape}")
    if within.shape != grid.shape or within.dtype != np.bool_:
        raise BadInput(f"inside must be bool of shape {grid.shape}, got {within.dtype} of {within.shape}")
    if len(np.unique(sites, axis=0)) < len(sites):
        raise BadInput("sites must be distinct, got two at one place")
    cells = np.zeros(grid.shape, np.int32)
    distance = np.zeros(grid.shape, np.float32)
    _voronoi(grid.to_index(sites), within, grid.spacing, cells, distance)
    return FracturePattern(grid, connected_labels(cells), np.minimum(distance, FAR))


@njit(cache=True, inline="always")
def _squared(sites: np.ndarray, s: int, x: float, y: float, z: float) -> float:
    return (sites[s, 0] - x) ** 2 + (sites[s, 1] - y) ** 2 + (sites[s, 2] - z) ** 2


@njit(cache=True)
def _voronoi(sites: np.ndarray, inside: np.ndarray, spacing: float, cells: np.ndarray, distance: np.ndarray) -> None:
    r, n = inside.shape[0], len(sites)
    for i in range(r):
        squared = np.empty(n)
        for j in range(r):
            for k in range(r):
                if not inside[i, j, k]:
                    continue
                own = 0
                for s in range(n):
                    squared[s] = _squared(sites, s, i, j, k)
                    if squared[s] < squared[own]:
                        own = s
                wall = np.inf
                for s in range(n):
                    if s != own:
                        # Plane halfway between two sites; cells are convex, so the nearest wall decides.
                        apart = np.sqrt(_squared(sites, s, sites[own, 0], sites[own, 1], sites[own, 2]))
                        wall = min(wall, (squared[s] - squared[own]) / (2 * apart))
                cells[i, j, k] = own + 1
                distance[i, j, k] = wall * spacing
