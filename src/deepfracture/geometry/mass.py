"""Mass, centre and inertia of a solid with uniform density, exact for its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.types import BadInput, Floats, Mesh


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
    pivot = mesh.bounds.mean(axis=0) if len(mesh.vertices) else np.zeros(3)
    corners = mesh.triangles - pivot  # (m, 3, 3)
    volumes = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume = float(volumes.sum())
    if not volume > 0:
        raise BadInput(f"the mesh encloses a volume of {volume:.3g}; it must be closed and face outward")
    sums = corners.sum(axis=1)  # (m, 3)
    centre = volumes @ sums / (4 * volume)
    # Integral of x x^T over a tetrahedron with one corner at the pivot:
    # volume / 20 * (sum over corners of c c^T + (sum of c) (sum of c)^T).
    moments = np.einsum("n,nci,ncj->ij", volumes, corners, corners) + np.einsum("n,ni,nj->ij", volumes, sums, sums)
    moments = moments / 20 - volume * np.outer(centre, centre)
    inertia = density * (np.trace(moments) * np.eye(3) - moments)
    return MassProperties(volume, density * volume, centre + pivot, (inertia + inertia.T) / 2)
