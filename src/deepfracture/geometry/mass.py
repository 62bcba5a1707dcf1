"""Mass, centre and inertia of a solid with uniform density, exact for its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.types import BadInput, Floats, Ints, Mesh


@dataclass(frozen=True, eq=False)
class MassProperties:
    """What a rigid body needs to know of a solid."""

    volume: float
    """[m^3]"""
    mass: float
    """[kg]"""
    centre: Floats
    """Centre of mass [m], shape (3,), in the mesh's frame."""
    inertia: Floats
    """Inertia tensor about the centre of mass, mesh axes [kg m^2], shape (3, 3)."""


def mass_properties(mesh: Mesh, density: float) -> MassProperties:
    """Mass properties of a closed, outward-oriented mesh of uniform density [kg/m^3].

    Signed tetrahedra from a point inside the box to every triangle; second moments of a
    tetrahedron as in Tonon 2004. Raises BadInput for density <= 0 or volume <= 0."""
    if not 0 < density < np.inf:
        raise BadInput(f"density must be positive and finite, got {density}")
    # Near the mesh, so that far-off bodies lose no digits.
    pivot = mesh.vertices[mesh.faces[0, 0]] if len(mesh.faces) else np.zeros(3)
    volume, first, second = _moments(mesh.vertices, mesh.faces, pivot)
    if not volume > 0:
        raise BadInput(f"the mesh encloses a volume of {volume:.3g}; it must be closed and face outward")
    centre = first / volume
    moments = second - volume * np.outer(centre, centre)
    inertia = density * (np.trace(moments) * np.eye(3) - moments)
    return MassProperties(volume, density * volume, centre + pivot, (inertia + inertia.T) / 2)


@njit(cache=True, nogil=True)
def _moments(vertices: Floats, faces: Ints, pivot: Floats):  # pragma: no cover
    """Volume and the integrals of x and x x^T about the pivot.

    For a tetrahedron with one corner there they are volume / 4 * sum of corners c, and
    volume / 20 * (sum of c c^T + (sum of c) (sum of c)^T)."""
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    a, b, c, total = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(len(faces)):
        for x in range(3):
            a[x] = vertices[faces[f, 0], x] - pivot[x]
            b[x] = vertices[faces[f, 1], x] - pivot[x]
            c[x] = vertices[faces[f, 2], x] - pivot[x]
            total[x] = a[x] + b[x] + c[x]
        part = a[0] * (b[1] * c[2] - b[2] * c[1])
        part += a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
        part /= 6
        volume += part
        for x in range(3):
            first[x] += part * total[x] / 4
            for y in range(x, 3):
                second[x, y] += part * (a[x] * a[y] + b[x] * b[y] + c[x] * c[y] + total[x] * total[y]) / 20
    for x in range(3):
        for y in range(x):
            second[x, y] = second[y, x]
    return volume, first, second
