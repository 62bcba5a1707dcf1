"""From the user's coordinates to the body frame."""

from __future__ import annotations

from deepfracture.types import BadInput, Mesh, Shape


def normalise(mesh: Mesh, name: str) -> Shape:
    """The mesh in its body frame: longest side of the box 2, centred; keeps the way back.

    Raises BadInput for a mesh without triangles or extent."""
    if not len(mesh.faces):
        raise BadInput(f"{name}: the mesh has no triangles")
    low, high = mesh.bounds
    scale, centre = float((high - low).max()) / 2, (low + high) / 2
    if not scale > 0:
        raise BadInput(f"{name}: all vertices are the same point")
    return Shape(name, Mesh((mesh.vertices - centre) / scale, mesh.faces), scale, centre)
