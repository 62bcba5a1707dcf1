"""Closed-form integrals of the Kelvin solution over flat triangles.

For a field point x and a point y of the triangle let r = y - x, n the unit normal, z = r.n its
constant height. Every boundary integral of linear elastostatics over a flat triangle is made of

    potential      ∫ 1/r dA                      solid angle    Ω = z ∫ 1/r^3 dA
    flux_i         ∫ r_i / r^3 dA                spread_ij      ∫ r_i r_j / r^3 dA
    normal_ij      3 z ∫ r_i r_j / r^5 dA        edge_ij        ∫ r_i r_j / r^3 ds along each edge

The surface divergence theorem turns them into the solid angle (van Oosterom & Strackee 1983) and
logarithms along the edges (Wilton et al. 1984). The contraction of 3 ∫ r_i r_j r_k / r^5 with a
tangential vector g needs no new integral: from ∂_k (r_i r_j / r^3),

    3 ∫ r_i r_j (r.g) / r^5 dA = g_i flux_j + g_j flux_i - Σ_edges (g.ν) edge_ij,

with ν the in-plane outward normal of the edge. No integral is singular, however near x lies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from deepfracture.types import BadInput, Floats, Mesh

# Contractions and reciprocals may be fused; NaN, infinity and the order of sums keep their meaning.
FASTMATH = {"contract", "arcp", "nsz", "afn"}
# Divisions go unchecked (error_model): the kernels test what they divide by. Inlining spares the arrays'
# headers, which cost more than the integrals. Callers in other files keep their cached machine code when
# this file changes: clear __pycache__ then.
kernel = njit(cache=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
parallel_kernel = njit(cache=True, fastmath=FASTMATH, error_model="numpy", parallel=True)

ON_LINE = 1e-20
"""Squared distance to an edge's line, in squared edge lengths, below which x counts as on that line."""
IN_PLANE = 1e-14
"""Triple product of the corner directions (unit vectors) below which the solid angle is zero."""
SLIVER = 1e-6
"""Least ratio of height to longest edge of a triangle that can be integrated over."""


class Panels(NamedTuple):
    """The flat triangles of a surface and their local frames."""

    corners: Floats
    """Shape (n, 3, 3)."""
    normals: Floats
    """Outward unit normals, shape (n, 3)."""
    tangents: Floats
    """Unit vectors along the edges, edge e from corner e to e + 1, shape (n, 3, 3)."""
    outward: Floats
    """In-plane unit normals of the edges, shape (n, 3, 3)."""
    gradients: Floats
    """Surface gradients of the linear functions that are 1 at a corner and 0 at the others, (n, 3, 3)."""
    areas: Floats
    """Shape (n,)."""
    centres: Floats
    """Shape (n, 3)."""
    radii: Floats
    """Distance from the centre to the farthest corner, shape (n,)."""


def panels(mesh: Mesh) -> Panels:
    """The panels of a mesh. Raises BadInput for a triangle without area."""
    corners = np.ascontiguousarray(mesh.triangles)
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=2)
    cross = np.cross(edges[:, 0], edges[:, 1])
    doubled = np.linalg.norm(cross, axis=1)
    flat = doubled <= SLIVER * lengths.max(axis=1, initial=0.0) ** 2
    if flat.any():
        raise BadInput(f"{flat.sum()} triangles have no area (first: {np.argmax(flat)}); remesh the surface")
    normals = cross / doubled[:, None]
    tangents = edges / lengths[:, :, None]
    outward = np.cross(tangents, normals[:, None, :])
    # Corner a lies opposite edge a + 1, at the height doubled / length.
    heights = doubled[:, None] / lengths
    gradients = np.roll(-outward / heights[:, :, None], -1, axis=1)
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    return Panels(
        corners,
        normals,
        np.ascontiguousarray(tangents),
        np.ascontiguousarray(outward),
        np.ascontiguousarray(gradients),
        0.5 * doubled,
        centres,
        radii,
    )


@kernel
def _solid_angle(r, lengths):
    """Signed solid angle of the triangle with corners r (3, 3) seen from the origin: positive when the
    normal points away from it (van Oosterom & Strackee 1983, eq. 8)."""
    triple = (
        r[0, 0] * (r[1, 1] * r[2, 2] - r[1, 2] * r[2, 1])
        - r[0, 1] * (r[1, 0] * r[2, 2] - r[1, 2] * r[2, 0])
        + r[0, 2] * (r[1, 0] * r[2, 1] - r[1, 1] * r[2, 0])
    )
    product = lengths[0] * lengths[1] * lengths[2]
    if abs(triple) <= IN_PLANE * product:
        return 0.0
    dot01 = r[0, 0] * r[1, 0] + r[0, 1] * r[1, 1] + r[0, 2] * r[1, 2]
    dot12 = r[1, 0] * r[2, 0] + r[1, 1] * r[2, 1] + r[1, 2] * r[2, 2]
    dot20 = r[2, 0] * r[0, 0] + r[2, 1] * r[0, 1] + r[2, 2] * r[0, 2]
    return 2.0 * np.arctan2(triple, product + dot01 * lengths[2] + dot12 * lengths[0] + dot20 * lengths[1])


@kernel
def _edge_logarithm(start, stop, length_start, length_stop, distance2):
    """∫ ds / r along an edge from `start` to `stop` (signed, from the foot of x), `distance2` the squared
    distance of x to its line (Wilton et al. 1984, eq. 5). On the edge itself the logarithm is cut off."""
    extent = stop - start
    on_line = distance2 < ON_LINE * extent * extent
    if start >= 0.0:
        if on_line and start <= 1e-10 * extent:
            return 0.0
        return np.log((length_stop + stop) / (length_start + start))
    if stop <= 0.0:
        if on_line and -stop <= 1e-10 * extent:
            return 0.0
        return np.log((length_start - start) / (length_stop - stop))
    floor = max(distance2, ON_LINE * extent * extent)
    return np.log((length_stop + stop) * (length_start - start) / floor)


@kernel
def _row(matrix, index):
    """A vector as a tuple: unlike a view it stays in registers."""
    return matrix[index, 0], matrix[index, 1], matrix[index, 2]


@kernel
def _corner_offsets(x, y, z, corners, index, r, lengths):
    for corner in range(3):
        r[corner, 0] = corners[index, corner, 0] - x
        r[corner, 1] = corners[index, corner, 1] - y
        r[corner, 2] = corners[index, corner, 2] - z
        lengths[corner] = np.sqrt(r[corner, 0] ** 2 + r[corner, 1] ** 2 + r[corner, 2] ** 2)


@kernel
def _edge_moments(start, stop, length_start, length_stop, offset, height):
    """∫ 1/r, ∫ l/r, ∫ l^2/r^3, ∫ l/r^3 and ∫ 1/r^3 along an edge, l the distance from the foot of x.

    `offset` is the in-plane distance of x to the edge's line, `height` that to the plane."""
    distance2 = offset * offset + height * height
    log = _edge_logarithm(start, stop, length_start, length_stop, distance2)
    inverse_start = 1.0 / length_start if length_start > 0.0 else 0.0
    inverse_stop = 1.0 / length_stop if length_stop > 0.0 else 0.0
    turn = stop * inverse_stop - start * inverse_start
    across = 0.0
    if distance2 >= ON_LINE * (stop - start) ** 2:
        across = turn / distance2
    return log, length_stop - length_start, log - turn, inverse_start - inverse_stop, across


@kernel
def _add_edge(e, log, rise, along2, along, across, offset, height, s, v, n, flux, spread, normal, edge):
    """Add one edge's part to the integrals, upper triangles only."""
    for i in range(3):
        flux[i] -= v[i] * log
        foot_i = offset * v[i] + height * n[i]
        along_i = along2 * s[i] + along * foot_i
        across_i = along * s[i] + across * foot_i
        level_i = offset * log * v[i] + rise * s[i]
        for j in range(i, 3):
            edge[e, i, j] = along_i * s[j] + across_i * (offset * v[j] + height * n[j])
            spread[i, j] -= v[j] * level_i
            # Σ v_j ∫ r_i / r^3 ds, made symmetric in i, j by the normal part.
            normal[i, j] -= v[j] * across_i + height * across * v[i] * n[j]


@kernel
def triangle_integrals(x, y, z, panels, index, on_panel, r, lengths, flux, spread, normal, edge):
    """All integrals over panel `index` seen from (x, y, z); see the head of this file.

    Fills flux (3,), spread (3, 3), normal (3, 3), edge (3, 3, 3), with r (3, 3) and lengths (3,) as
    workspace, and returns (potential, solid angle, height). With `on_panel` the point lies on the panel:
    height, solid angle and `normal` are zero, the principal value.
    """
    _corner_offsets(x, y, z, panels.corners, index, r, lengths)
    n = _row(panels.normals, index)
    height = 0.0
    omega = 0.0
    if not on_panel:
        height = n[0] * r[0, 0] + n[1] * r[0, 1] + n[2] * r[0, 2]
        omega = _solid_angle(r, lengths)
    flux[:] = 0.0
    spread[:] = 0.0
    normal[:] = 0.0
    potential = -height * omega
    across_sum = 0.0
    for e in range(3):
        f = (e + 1) % 3
        s, v = _row(panels.tangents[index], e), _row(panels.outward[index], e)
        start = s[0] * r[e, 0] + s[1] * r[e, 1] + s[2] * r[e, 2]
        stop = s[0] * r[f, 0] + s[1] * r[f, 1] + s[2] * r[f, 2]
        offset = v[0] * r[e, 0] + v[1] * r[e, 1] + v[2] * r[e, 2]
        log, rise, along2, along, across = _edge_moments(start, stop, lengths[e], lengths[f], offset, height)
        potential += offset * log
        across_sum += offset * across
        _add_edge(e, log, rise, along2, along, across, offset, height, s, v, n, flux, spread, normal, edge)
    _close(potential, omega, height, across_sum, n, flux, spread, normal, edge)
    return potential, omega, height


@kernel
def _close(potential, omega, height, across_sum, n, flux, spread, normal, edge):
    """Add the parts along the normal, and mirror the upper triangles. `flux` comes in tangential."""
    for i in range(3):
        for j in range(i, 3):
            both = n[i] * n[j]
            spread[i, j] += height * (n[i] * flux[j] + flux[i] * n[j]) + both * (height * omega - potential)
            normal[i, j] = height * (normal[i, j] + both * across_sum)
            if i == j:
                spread[i, i] += potential
                normal[i, i] += omega
            spread[j, i], normal[j, i] = spread[i, j], normal[i, j]
            for e in range(3):
                edge[e, j, i] = edge[e, i, j]
    for i in range(3):
        flux[i] += n[i] * omega
