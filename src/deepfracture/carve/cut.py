"""Fragments out of the original mesh: each cell of a pattern intersected with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.carve.cells import MARGIN, cell_field
from deepfracture.carve.nets import Cells, surface_nets
from deepfracture.geometry import mass_properties
from deepfracture.types import BadInput, FracturePattern, Fragment, Fragments, Grid, Mesh, Shape

if TYPE_CHECKING:
    from manifold3d import Manifold

CRUMB_VOXELS = 4.0
"""A piece below this volume [voxels] that the cut leaves over joins the neighbour it fits best."""
ROUNDING = 1e-13
"""Share of a cell's volume below which a part of it is flat: nothing but rounding."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """One connected piece of the cut body."""

    mesh: Mesh
    own: np.ndarray
    """Whether each face lies on the body's own surface, shape (m,)."""
    names: np.ndarray
    """For each face the triangle of the original or the face of the cell that it lies in, shape (m,)."""

    @cached_property
    def volume(self) -> float:
        return self.mesh.volume

    @cached_property
    def cracks(self) -> np.ndarray:
        """Names of the cells' faces that it shows, sorted."""
        return np.unique(self.names[~self.own])

    def with_void(self, void: _Piece) -> _Piece:
        faces = np.concatenate([self.mesh.faces, void.mesh.faces + len(self.mesh.vertices)])
        mesh = Mesh(np.concatenate([self.mesh.vertices, void.mesh.vertices]), faces)
        own = np.concatenate([self.own, void.own])
        return _Piece(mesh, own, np.concatenate([self.names, void.names]))

    def solid(self, body_id: int) -> Manifold:
        return _solid(self.mesh, self.names, self.own, body_id)


def cut(shape: Shape, pattern: FracturePattern, *, density: float) -> Fragments:
    """Cut the original mesh of a shape along a pattern's cracks.

    Every fragment is one connected solid with a closed 2-manifold surface; together they fill the original.
    Outside, their triangles are the original's, untouched except where a crack crosses them; neighbours
    hold the same crack vertices. Parts of a label that do not hang together become fragments of their own; dust joins
    a neighbour (see `cells.DUST_VOXELS`, `CRUMB_VOXELS`).

    Args:
        shape: The whole body.
        pattern: Its cracks, on any grid.
        density: [kg/m^3]

    Raises:
        BadInput: The mesh is not closed and oriented, or density is not positive.
    """
    from manifold3d import Manifold

    if not density > 0:
        raise BadInput(f"density must be positive, got {density}")
    faces = np.arange(len(shape.mesh.faces))
    body_id = Manifold.reserve_ids(1)
    body = _solid(shape.mesh, faces, np.ones(len(faces), bool), body_id)
    if body.status().name != "NoError" or not body.volume() > 0:
        raise BadInput(f"{shape.name}: cannot be cut, its mesh is not closed and oriented; try --repair")
    field = cell_field(shape.mesh, pattern)
    if field.count < 2:
        return Fragments((_fragment(shape.mesh, faces, density),))
    solids = _cell_solids(surface_nets(field), pattern.grid, body_id)
    pieces = [piece for cell in solids for piece in _pieces(body ^ cell, body_id)]
    pieces = _join_crumbs(pieces, CRUMB_VOXELS * pattern.grid.spacing**3, body_id)
    sources = [np.where(piece.own, piece.names, -1) for piece in pieces]
    return Fragments(
        tuple(_fragment(piece.mesh, source, density) for piece, source in zip(pieces, sources, strict=True))
    )


def _solid(mesh: Mesh, names: np.ndarray, own: np.ndarray, body_id: int) -> Manifold:
    """A solid whose faces keep their names through booleans; `own` ones are the original's.

    Each face needs a name of its own among its kind, or coplanar neighbours would be merged."""
    from manifold3d import Manifold, Mesh64

    order = np.argsort(~own, kind="stable")
    ends = [0, 3 * int(own.sum()), 3 * len(own)]
    return Manifold(
        Mesh64(
            vert_properties=np.array(mesh.vertices),
            tri_verts=mesh.faces[order].astype(np.uint64),
            run_index=np.array(ends, np.uint64),
            run_original_id=np.array([body_id, Manifold.reserve_ids(1)], np.uint32),
            face_id=names[order].astype(np.uint64),
        )
    )


def _cell_solids(cells: Cells, grid: Grid, body_id: int) -> Iterator[Manifold]:
    world = grid.to_world(cells.points - MARGIN)
    for n in range(len(cells.face_start) - 1):
        own = slice(cells.face_start[n], cells.face_start[n + 1])
        points = world[cells.vertices[cells.vertex_start[n] : cells.vertex_start[n + 1]]]
        faces, names = cells.faces[own], cells.names[own]
        solid = _solid(Mesh(points, faces), names, np.zeros(len(faces), bool), body_id)
        assert solid.status().name == "NoError", f"cell {n + 1}: {solid.status().name}"
        yield solid


def _pieces(solid: Manifold, body_id: int) -> list[_Piece]:
    """The connected parts of a solid, each with the voids inside it."""
    shells = [_shell(shell, body_id) for shell in solid.decompose()]
    flat = ROUNDING * sum(abs(shell.volume) for shell in shells)
    parts = sorted((shell for shell in shells if shell.volume > flat), key=lambda part: part.volume)
    solids = [part.mesh for part in parts]
    for void in (shell for shell in shells if shell.volume < -flat):
        # The smallest part around a void holds it; with one part there is no choice.
        around = [n for n, mesh in enumerate(solids[:-1]) if _encloses(mesh, void.mesh.vertices[0])]
        n = around[0] if around else len(parts) - 1
        parts[n] = parts[n].with_void(void)
    return parts


def _shell(solid: Manifold, body_id: int) -> _Piece:
    out = solid.to_mesh64()
    lengths = np.diff(np.asarray(out.run_index, np.int64)) // 3
    own = np.repeat(np.asarray(out.run_original_id) == body_id, lengths)
    mesh = Mesh(out.vert_properties[:, :3], np.asarray(out.tri_verts, np.int64))
    return _Piece(mesh, own, np.asarray(out.face_id, np.int64))


def _encloses(mesh: Mesh, point: np.ndarray) -> bool:
    """Whether a closed mesh winds around a point off its surface (van Oosterom & Strackee 1983)."""
    a, b, c = np.moveaxis(mesh.triangles - point, 1, 0)
    x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    dots = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
    angle = 2 * np.arctan2((a * np.cross(b, c)).sum(1), dots)
    return bool(angle.sum() > 2 * np.pi)


def _join_crumbs(pieces: list[_Piece], smallest: float, body_id: int) -> list[_Piece]:
    """Unite pieces below the volume `smallest` with the larger piece behind most of their crack faces.

    A crumb that touches no larger piece, or only along a line, stays as debris."""
    from manifold3d import Manifold, OpType

    whole = [piece for piece in pieces if piece.volume >= smallest]
    joining: dict[int, list[_Piece]] = {}
    kept = []
    for crumb in (piece for piece in pieces if piece.volume < smallest):
        shared = [len(np.intersect1d(crumb.cracks, piece.cracks, assume_unique=True)) for piece in whole]
        if max(shared, default=0) > 0:
            joining.setdefault(int(np.argmax(shared)), []).append(crumb)
        else:
            kept.append(crumb)
    for n, piece in enumerate(whole):
        if n in joining:
            solids = [part.solid(body_id) for part in (piece, *joining[n])]
            kept += _pieces(Manifold.batch_boolean(solids, OpType.Add), body_id)
        else:
            kept.append(piece)
    return kept


def _fragment(mesh: Mesh, source: np.ndarray, density: float) -> Fragment:
    mass = mass_properties(mesh, density)
    return Fragment(mesh, source, mass.mass, mass.centre, mass.inertia)
