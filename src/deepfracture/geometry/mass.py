"""Mass, centre and inertia of a solid with uniform density, exact for its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.types import BadInput, Floats, Ints, Mesh


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass, centre of mass and inertia of a rigid body."""

    mass: float
    """[kg]"""
    centre: Floats
    """Centre of mass [m], shape (3,), in the mesh's frame."""
    inertia: Floats
    """Inertia tensor about the centre of mass, mesh axes [kg m^2], shape (3, 3)."""

    def principal(self) -> tuple[Floats, Floats]:
        """Principal moments of inertia [kg m^2], shape (3,), and the rotation mesh_from_principal, shape (3, 3)."""
        moments, axes = np.linalg.eigh(self.inertia)
        if np.linalg.det(axes) < 0:
            axes[:, 0] *= -1
        return moments, axes


def mass_properties(mesh: Mesh, density: float) -> MassProperties:
    """Mass properties of a closed, outward-oriented mesh of uniform density [kg/m^3].

    Signed tetrahedra from a point inside the box to every triangle; second moments of a
    tetrahedron as in Tonon 2004. Raises BadInput for density <= 0 or volume <= 0."""
    # Near the mesh, so that far-off bodies lose no digits.
    pivot = mesh.vertices[mesh.faces[0, 0]] if len(mesh.faces) else np.zeros(3)
    volume, first, second = moments(mesh.vertices, mesh.faces, pivot)
    return properties_from_moments(volume, first, second, pivot, density)


def properties_from_moments(
    volume: float, first: Floats, second: Floats, pivot: Floats, density: float
) -> MassProperties:
    """Mass properties from `moments` about a pivot. Raises BadInput for density <= 0 or volume <= 0."""
    if not 0 < density < np.inf:
        raise BadInput(f"density must be positive and finite, got {density}")
    if not volume > 0:
        raise BadInput(f"the mesh encloses a volume of {volume:.3g}; it must be closed and face outward")
    centre = first / volume
    second = second - volume * np.outer(centre, centre)
    inertia = density * (np.trace(second) * np.eye(3) - second)
    return MassProperties(density * volume, centre + pivot, (inertia + inertia.T) / 2)


@njit(cache=True, nogil=True)
def moments(vertices: Floats, faces: Ints, pivot: Floats):  # pragma: no cover
    """Volume and the integrals of x and x x^T about a pivot, of a closed mesh that faces outward.

    For a tetrahedron with one corner there they are volume / 4 * sum of corners c, and
    volume / 20 * (sum of c c^T + (sum of c) (sum of c)^T)."""
    p, q, r = pivot
    volume, x, y, z, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = vertices[a, 0] - p, vertices[a, 1] - q, vertices[a, 2] - r
        bx, by, bz = vertices[b, 0] - p, vertices[b, 1] - q, vertices[b, 2] - r
        cx, cy, cz = vertices[c, 0] - p, vertices[c, 1] - q, vertices[c, 2] - r
        sx, sy, sz = ax + bx + cx, ay + by + cy, az + bz + cz
        part = (ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)) / 6
        volume += part
        x, y, z = x + part * sx, y + part * sy, z + part * sz
        xx += part * (ax * ax + bx * bx + cx * cx + sx * sx)
        xy += part * (ax * ay + bx * by + cx * cy + sx * sy)
        xz += part * (ax * az + bx * bz + cx * cz + sx * sz)
        yy += part * (ay * ay + by * by + cy * cy + sy * sy)
        yz += part * (ay * az + by * bz + cy * cz + sy * sz)
        zz += part * (az * az + bz * bz + cz * cz + sz * sz)
    return volume, np.array([x, y, z]) / 4, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) / 20
