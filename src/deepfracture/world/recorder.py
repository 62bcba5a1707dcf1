"""Writes down where every body is, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from deepfracture.types import Floats, Fragments, Ints, Mesh, Recording, Shape, Track
from deepfracture.world.engine import Motion, rotation
from deepfracture.world.scene import Block, Scene
from deepfracture.world.stage import Body, block_motion

FLOOR_HALF = 6.0
"""Half the side of the floor that is shown [m]."""
FLOOR_THICKNESS = 0.1
"""Of the floor that is shown [m]."""


@dataclass
class _Line:
    name: str
    kind: str
    mesh: Mesh
    source: Ints | None
    whole: Shape | None
    start: int
    positions: list[Floats] = field(default_factory=list)
    quats: list[Floats] = field(default_factory=list)


class Recorder:
    """Collects frames; `recording` makes them a `Recording`."""

    def __init__(self, scene: Scene, reference: Shape) -> None:
        self._scene = scene
        self._reference = reference
        self.frame_time = 1 / scene.frame_rate
        """Seconds between frames."""
        self._lines: dict[int, _Line] = {}
        self.frames = 0
        """How many are written down."""
        self._pieces: dict[int, tuple[Ints, Shape]] = {}

    def knows(self, bodies: list[Body], fragments: Fragments, whole: Shape) -> None:
        """Which faces of new fragments are crack surface, and of which whole the others are."""
        for body, piece in zip(bodies, fragments, strict=True):
            self._pieces[body.number] = piece.source, whole

    def frame(self, moving: list[tuple[Body, Motion]]) -> None:
        """One frame: everything that exists now."""
        for body, motion in moving:
            if body.number not in self._lines:
                mesh = body.mesh if body.mesh is not None else ball_mesh(body.radius)
                source, whole = self._pieces.get(body.number, (None, body.shape))
                self._lines[body.number] = _Line(body.name, body.kind, mesh, source, whole, self.frames)
            line = self._lines[body.number]
            line.positions.append(motion.position)
            line.quats.append(motion.quat_wxyz)
        self.frames += 1

    def recording(self) -> Recording:
        tracks = [
            Track(
                line.name,
                line.kind,
                line.mesh,
                line.source,
                line.start,
                np.array(line.positions),
                np.array(line.quats),
                line.whole,
            )
            for line in self._lines.values()
        ]
        if self._scene.floor is not None:
            place = np.tile([0.0, 0.0, self._scene.floor.height], (self.frames, 1))
            still = np.tile([1.0, 0.0, 0.0, 0.0], (self.frames, 1))
            tracks.append(Track("floor", "floor", floor_mesh(), None, 0, place, still))
        tracks += [self._block(i, block) for i, block in enumerate(self._scene.blocks)]
        return Recording(self.frame_time, tuple(tracks), self._user_from_world())

    def _block(self, number: int, block: Block) -> Track:
        stays = block_motion(block)
        place, turn = (np.tile(value, (self.frames, 1)) for value in (stays.position, stays.quat_wxyz))
        return Track(f"block{number}", "block", block_mesh(block.half_sides), None, 0, place, turn)

    def _user_from_world(self) -> Floats:
        """Where the first shape's file has it, it is at the start."""
        placed = self._scene.shapes[0]
        turn = rotation(np.asarray(placed.quat_wxyz)).T
        similarity = np.eye(4)
        similarity[:3, :3] = self._reference.scale * turn
        similarity[:3, 3] = self._reference.to_user(-turn @ np.asarray(placed.position))
        return similarity


def ball_mesh(radius: float) -> Mesh:
    """A sphere about the origin."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return Mesh(sphere.vertices, sphere.faces)


def block_mesh(half_sides: tuple[float, float, float]) -> Mesh:
    """A box about the origin."""
    import trimesh

    box = trimesh.creation.box(2 * np.asarray(half_sides))
    return Mesh(box.vertices, box.faces)


def floor_mesh() -> Mesh:
    """A slab whose top is z = 0."""
    import trimesh

    slab = trimesh.creation.box((2 * FLOOR_HALF, 2 * FLOOR_HALF, FLOOR_THICKNESS))
    return Mesh(slab.vertices - [0, 0, FLOOR_THICKNESS / 2], slab.faces)
