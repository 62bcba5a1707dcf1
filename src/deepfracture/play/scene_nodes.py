"""The bodies of a world as nodes of a viser scene."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.export.viser_scene import add_surface
from deepfracture.recording.motion import KEY_TOL
from deepfracture.recording.surface import COLOURS, OUTER_CREASE, surfaces
from deepfracture.types import Floats32, Ints, Mesh, Shape
from deepfracture.world import Pose

if TYPE_CHECKING:
    from viser import SceneApi, SceneNodeHandle


class ClientScene:
    """The scene in one browser: a node for each body that ever existed, sent once and then only moved."""

    def __init__(self, scene: SceneApi) -> None:
        self._scene = scene
        self._nodes: dict[int, SceneNodeHandle] = {}
        self._rows: dict[int, int] = {}
        self._poses = np.zeros((64, 7))
        """Position and rotation of each body as last sent, in the rows of `_rows`."""
        self._shown: set[int] = set()
        self._world = 0

    def __len__(self) -> int:
        return len(self._nodes)

    def show(self, poses: Sequence[Pose]) -> int:
        """Show the bodies at their poses and hide all others. Returns the number of messages sent.

        To be called within `client.atomic()`, so that the update is drawn at once."""
        sent = 0
        for pose in poses:
            if pose.number not in self._nodes:
                self._nodes[pose.number] = self._add(pose)
                self._register(pose)
                sent += 1
        sent += self._move(poses)
        there = {pose.number for pose in poses}
        for number in there ^ self._shown:
            self._nodes[number].visible = number in there
            sent += 1
        self._shown = there
        return sent

    def clear(self) -> None:
        """Remove all nodes."""
        for node in self._nodes.values():
            node.remove()
        self._nodes.clear()
        self._rows.clear()
        self._shown.clear()
        self._world += 1  # names are never reused, so a late message cannot reach another body

    def _register(self, pose: Pose) -> None:
        """A row for a new body, whose node is visible and has its pose."""
        row = self._rows[pose.number] = len(self._rows)
        if row == len(self._poses):
            self._poses = np.concatenate([self._poses, np.zeros_like(self._poses)])
        self._poses[row] = *pose.position, *pose.quat_wxyz
        self._shown.add(pose.number)

    def _move(self, poses: Sequence[Pose]) -> int:
        """Send the poses that have changed.

        The setters of viser's handles compare by `np.allclose`, 0.2 ms each: 40 ms for 100 bodies."""
        from viser import _messages

        if not poses:
            return 0
        rows = [self._rows[pose.number] for pose in poses]
        now = np.concatenate([[p.position for p in poses], [p.quat_wxyz for p in poses]], axis=1)
        changed = np.abs(now - self._poses[rows]) > KEY_TOL
        sent = np.stack([changed[:, :3].any(axis=1), changed[:, 3:].any(axis=1)], axis=1)
        queue = self._scene._queue_scene_message
        for k in np.flatnonzero(sent.any(axis=1)).tolist():
            name, (x, y, z, *quat) = self._nodes[poses[k].number].name, now[k].tolist()
            if sent[k, 0]:
                queue(_messages.SetPositionMessage(name, (x, y, z)))
            if sent[k, 1]:
                queue(_messages.SetOrientationMessage(name, (quat[0], quat[1], quat[2], quat[3])))
        self._poses[rows] = np.where(np.repeat(sent, (3, 4), axis=1), now, self._poses[rows])
        return int(sent.sum())

    def _add(self, pose: Pose) -> SceneNodeHandle:
        name = f"/world{self._world}/{pose.number}_{pose.kind}"
        if pose.whole is not None and pose.whole.appearance is not None:
            return self._add_textured(pose, name)
        node = None
        for look, vertices, faces in plain_surfaces(pose.mesh, pose.source, pose.whole, pose.kind):
            if node is not None:
                self._scene.add_mesh_simple(f"{name}/{look}", vertices, faces, color=COLOURS[look])
                continue
            node = self._scene.add_mesh_simple(
                name, vertices, faces, color=COLOURS[look], position=pose.position, wxyz=pose.quat_wxyz
            )
        assert node is not None
        return node

    def _add_textured(self, pose: Pose, name: str) -> SceneNodeHandle:
        """With the appearance of the user's file: slower, since each surface is sent as glTF."""
        frame = self._scene.add_frame(name, show_axes=False, position=pose.position, wxyz=pose.quat_wxyz)
        for k, surface in enumerate(surfaces(pose.mesh, pose.source, whole=pose.whole)):
            add_surface(self._scene, surface, f"{name}/{k}_{surface.look}")
        return frame


def plain_surfaces(mesh: Mesh, source: Ints | None, whole: Shape | None, kind: str) -> list[tuple[str, Floats32, Ints]]:
    """Surfaces of a body without an appearance: key into COLOURS, vertices and faces; the browser computes the normals.

    `recording.surface.surfaces` would take 10 ms a fragment, a delay between the hit and the first movement. Here the
    corners at a vertex share it, unless a crease of the whole separates their faces."""
    look = kind if kind in COLOURS else "outer"
    if whole is None:
        return [(look, mesh.vertices.astype(np.float32), mesh.faces)]
    source = np.arange(len(mesh.faces)) if source is None else source
    cracked = source < 0
    parts = []
    if not cracked.all():
        region = _regions(whole)[source[~cracked]]
        parts.append((look, *_split_vertices(mesh, mesh.faces[~cracked], region)))
    if cracked.any():
        parts.append(("inner", *_split_vertices(mesh, mesh.faces[cracked], np.zeros(int(cracked.sum()), np.int64))))
    return parts


def _split_vertices(mesh: Mesh, faces: Ints, region: Ints) -> tuple[Floats32, Ints]:
    """Vertices and faces of part of a mesh, each vertex once for every region that meets there."""
    corner = faces * (int(region.max()) + 1) + region[:, None]
    keys, faces = np.unique(corner, return_inverse=True)
    return mesh.vertices[keys // (int(region.max()) + 1)].astype(np.float32), faces.reshape(-1, 3)


@lru_cache(maxsize=8)
def _regions(shape: Shape) -> Ints:
    """Smooth region of each face, bounded by creases, shape (m,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    faces = shape.mesh.faces
    area = shape.mesh.area_vectors
    normals = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), 1e-300)
    sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    order = np.lexsort(sides.T)
    same = (sides[order][1:] == sides[order][:-1]).all(axis=1)
    left, right = order[:-1][same] // 3, order[1:][same] // 3
    smooth = np.einsum("ni,ni->n", normals[left], normals[right]) >= np.cos(np.radians(OUTER_CREASE))
    links = coo_matrix((np.ones(int(smooth.sum()), np.int8), (left[smooth], right[smooth])), (len(faces),) * 2)
    return connected_components(links, directed=False)[1].astype(np.int64)
