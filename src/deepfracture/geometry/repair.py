"""One closed solid from a mesh that is not one, its outside kept where it was.

First what keeps the input's own triangles: turn faces the right way, cap holes, smooth small tangles, merge shells.
Where that is not enough (non-manifold edges, surfaces that cross themselves widely, gaps between parts),
the mesh is wrapped: everything that cannot be reached from outside becomes solid."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.distance import closest_points
from deepfracture.geometry.orient import orient
from deepfracture.geometry.solids import union
from deepfracture.geometry.topology import (
    boundary_loops,
    compact,
    mesh_defects,
    shell_volumes,
    shells,
    split_pinches,
)
from deepfracture.geometry.untangle import self_intersecting_faces, untangle
from deepfracture.geometry.wrap import VOXELS, wrap
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Ints, Mesh

MAX_OVERLAP_DEPTH = 5000
"""Boxes of triangles that may lie over a place on average: a surface has a few, and time to search goes with them."""
SMALL_BODY = 0.02
"""Separate bodies below this share of the whole volume are dropped."""


def repair(mesh: Mesh, name: str) -> Mesh:
    """A closed, outward-oriented 2-manifold of one body near `mesh`; logs what was done.

    Caps and unions keep the input's triangles; a wrap stays within a hundredth of the longest
    side of the outside, save where it bridges gaps. Raises BadInput when no solid comes out, or the triangles
    overlap too deeply to be a surface."""
    _check_overlap_depth(mesh, name)
    before = mesh_defects(mesh)
    if before.closed and before.shells == 1 and not len(self_intersecting_faces(mesh)):
        log.info("%s: already closed, nothing to repair", name)
        return split_pinches(mesh if mesh.volume > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1]))
    sealed, holes = cap_holes(orient(split_pinches(mesh)))
    steps = [f"{holes} hole{'s' * (holes > 1)} capped"] if holes else []
    solid, smoothed = _union_of_shells(sealed)
    if smoothed:
        steps.append(f"{smoothed} faces that ran through others of their shell smoothed apart")
    if solid is None:
        solid, gap = wrap(sealed, name)
        steps.append(f"wrapped, bridging gaps of up to {gap:.3g}")
    elif mesh_defects(sealed).shells > 1:
        steps.append(f"{mesh_defects(sealed).shells} shells united")
    solid, dropped = _largest_body(solid, name)
    if dropped:
        steps.append(f"{dropped} small loose parts dropped")
    off = closest_points(mesh, solid.vertices).distance
    log.warning(
        "%s: repaired (%s): %s; result lies %.2g from the input at most, caps included, %.2g on average",
        name,
        before if str(before) else f"{before.shells} shell{'s' * (before.shells > 1)}",
        ", ".join(steps) or "faces turned outward",
        off.max(),
        off.mean(),
    )
    return split_pinches(solid)


def _check_overlap_depth(mesh: Mesh, name: str) -> None:
    corners = mesh.triangles
    sides, whole = np.ptp(corners, axis=1), np.ptp(mesh.bounds, axis=0)
    least = whole.max() / VOXELS
    depth = float((np.maximum(sides, least) / np.maximum(whole, least)).prod(axis=1).sum())
    if depth > MAX_OVERLAP_DEPTH:
        raise BadInput(f"{name}: large triangles overlap, {depth:.0f} deep on average; no solid can be made of them")


def cap_holes(mesh: Mesh) -> tuple[Mesh, int]:
    """The mesh with a fan over every hole, each shell then facing outward; and how many holes."""
    vertices, faces = [mesh.vertices], [mesh.faces]
    count = len(mesh.vertices)
    loops = boundary_loops(mesh.faces)
    for loop in loops:
        after = np.roll(loop, -1)
        if len(loop) == 3:
            faces.append(loop[None, :])
            continue
        vertices.append(mesh.vertices[loop].mean(axis=0)[None])
        faces.append(np.column_stack([loop, after, np.full(len(loop), count)]))
        count += 1
    capped = Mesh(np.concatenate(vertices), np.concatenate(faces))
    piece = shells(capped.faces)
    inward = shell_volumes(capped, piece)[piece] < 0
    return Mesh(capped.vertices, np.where(inward[:, None], capped.faces[:, ::-1], capped.faces)), len(loops)


def _union_of_shells(mesh: Mesh) -> tuple[Mesh | None, int]:
    """The union of all shells, None where a shell is not a plain solid or the union falls apart; and how many faces
    were smoothed so that no shell crosses itself."""
    if not mesh_defects(mesh).closed:
        return None, 0
    piece = shells(mesh.faces)
    smooth = untangle(mesh, piece)
    if smooth is None:
        return None, 0
    mesh, count = smooth
    parts = _split_shells(mesh, piece)
    if len(parts) == 1:
        return mesh, count
    try:
        solid = union(parts)
    except ValueError:
        return None, 0
    volumes = shell_volumes(solid, shells(solid.faces))
    whole = volumes.max() > (1 - SMALL_BODY) * np.abs(volumes).sum()
    plain = whole and mesh_defects(solid).closed and not len(self_intersecting_faces(solid))
    return (solid, count) if plain else (None, 0)


def _split_shells(mesh: Mesh, piece: Ints) -> list[Mesh]:
    order = np.argsort(piece, kind="stable")
    return [compact(mesh.vertices, mesh.faces[own]) for own in np.split(order, np.cumsum(np.bincount(piece))[:-1])]


def _largest_body(mesh: Mesh, name: str) -> tuple[Mesh, int]:
    """The one body, without small components and inner voids; and how many bodies were dropped."""
    piece = shells(mesh.faces)
    volumes = shell_volumes(mesh, piece)
    if not volumes.max() > 0:
        raise BadInput(f"{name}: encloses no volume and cannot be repaired; a solid is needed")
    bodies = volumes > 0
    large = int((volumes > SMALL_BODY * volumes[bodies].sum()).sum())
    if large > 1:
        raise BadInput(f"{name}: {large} separate bodies, one is needed; split the file")
    keep = piece == int(volumes.argmax())
    return compact(mesh.vertices, mesh.faces[keep]), int(bodies.sum()) - 1
