"""Difficult closed solids: triangles of zero area, slivers, half a million faces, thin legs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deepfracture.geometry import builtin, check_solid, normalise
from deepfracture.geometry.solids import union_of_boxes
from deepfracture.types import Floats, Ints, Mesh, Shape

MANY = 500_000
"""Faces of the finest mesh."""
SLIVER = 1e-6
"""Height of the slivers [m] in a frame where the shape is two metres long."""
TOUCHED = 200
"""Faces that get a degenerate neighbour or a sliver."""
LEG = 0.07
"""Thickness of the thin legs [m]: little more than two voxels of the 64^3 grid."""


def zero_area() -> Shape:
    """The pot with triangles whose corners lie on one line."""
    mesh = builtin("pot").mesh
    vertices, faces = list(mesh.vertices), mesh.faces.tolist()
    for n in _spread(mesh):
        a, b, c = faces[n]
        middle = len(vertices)
        vertices.append((mesh.vertices[a] + mesh.vertices[b]) / 2)
        # The neighbour across a-b keeps its edge; the flat triangle closes what is left between.
        faces[n] = [a, middle, c]
        faces += [[middle, b, c], [a, b, middle]]
    return _shape("zero_area", np.array(vertices), np.array(faces))


def slivers() -> Shape:
    """The pot with triangles a micrometre high."""
    mesh = builtin("pot").mesh
    vertices, faces = list(mesh.vertices), mesh.faces.tolist()
    for n in _spread(mesh):
        a, b, c = faces[n]
        foot, tip = (mesh.vertices[a] + mesh.vertices[b]) / 2, mesh.vertices[c]
        point = len(vertices)
        vertices.append(foot + SLIVER * (tip - foot) / np.linalg.norm(tip - foot))
        faces[n] = [a, b, point]
        faces += [[b, c, point], [c, a, point]]
    return _shape("slivers", np.array(vertices), np.array(faces))


def many_faces() -> Shape:
    """The pot with its triangles divided until there are half a million."""
    from manifold3d import Manifold, Mesh64

    mesh = builtin("pot").mesh
    solid = Manifold(Mesh64(np.array(mesh.vertices), mesh.faces.astype(np.uint64)))
    raw = solid.refine(int(np.ceil((MANY / len(mesh.faces)) ** 0.5))).to_mesh64()
    return _shape("many_faces", np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts, np.int64))


def thin_legs() -> Shape:
    """A stool on four legs that a coarse grid hardly sees."""
    across = np.unique(np.concatenate([np.linspace(-0.5, 0.5, 15), [LEG - 0.5, 0.5 - LEG]]))
    up = np.concatenate([np.linspace(0, 1.8, 24), np.linspace(1.8, 2.0, 4)[1:]])
    feet = [(x, y) for x in (-0.5, 0.5 - LEG) for y in (-0.5, 0.5 - LEG)]
    legs = [((x, y, 0), (x + LEG, y + LEG, 1.8)) for x, y in feet]
    return normalise(union_of_boxes([across, across, up], [*legs, ((-0.5, -0.5, 1.8), (0.5, 0.5, 2.0))]), "thin_legs")


DEGENERATE: dict[str, Callable[[], Shape]] = {
    make.__name__: make for make in (zero_area, slivers, many_faces, thin_legs)
}
"""Every case by name."""


def _spread(mesh: Mesh) -> Ints:
    """Some faces, evenly over the list, no two of them the same."""
    return np.linspace(0, len(mesh.faces) - 1, TOUCHED).astype(np.int64)


def _shape(name: str, vertices: Floats, faces: Ints) -> Shape:
    return normalise(check_solid(Mesh(vertices, faces), name), name)
