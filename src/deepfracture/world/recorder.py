"""Writes down where every body is, frame by frame."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from deepfracture.geometry.rotations import nlerp, rotation_matrix
from deepfracture.types import Floats, Fragments, Ints, Mesh, Recording, Rigid, Shape, Track
from deepfracture.world.engine import Motion
from deepfracture.world.scene import Block, Scene
from deepfracture.world.stage import Body, block_motion

FLOOR_HALF = 6.0
"""Half the side of the floor that is shown [m]."""
FLOOR_THICKNESS = 0.1
"""Of the floor that is shown [m]."""


class Pose(NamedTuple):
    """Where a body was."""

    number: int
    """Of the body: no other has it."""
    name: str
    kind: str
    """As in `types.Track`."""
    mesh: Mesh
    source: Ints | None
    whole: Shape | None
    position: Floats
    """Origin of its mesh frame [m], shape (3,)."""
    quat_wxyz: Floats
    """Rotation world_from_mesh, shape (4,)."""


@dataclass
class _Line:
    name: str
    kind: str
    mesh: Mesh
    source: Ints | None
    whole: Shape | None
    start: int
    body: Body
    # Numbers one after another: as arrays of their own they would take four times the memory.
    positions: array = field(default_factory=lambda: array("d"))
    quats: array = field(default_factory=lambda: array("d"))
    velocities: array = field(default_factory=lambda: array("d"))
    spins: array = field(default_factory=lambda: array("d"))

    def add(self, motion: Motion) -> None:
        """One more frame."""
        self.positions.frombytes(np.asarray(motion.position, float).tobytes())
        self.quats.frombytes(np.asarray(motion.quat_wxyz, float).tobytes())
        self.velocities.frombytes(np.asarray(motion.velocity, float).tobytes())
        self.spins.frombytes(np.asarray(motion.spin, float).tobytes())

    @property
    def count(self) -> int:
        """Frames in which it existed so far."""
        return len(self.positions) // 3

    def has(self, frame: int) -> bool:
        """Whether it existed in a frame of the recording."""
        return 0 <= frame - self.start < self.count

    def rigid(self) -> Rigid:
        mass = self.body.mass
        velocities, spins = _rows([self.velocities], 3), _rows([self.spins], 3)
        return Rigid(mass.mass, mass.centre, mass.inertia, velocities, spins, self.body.hulls)


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
                self._lines[body.number] = _Line(body.name, body.kind, mesh, source, whole, self.frames, body)
            self._lines[body.number].add(motion)
        self.frames += 1

    def at(self, frame: float) -> list[Pose]:
        """Where everything that moves was at a frame; between two frames it goes straight from one to the other."""
        first = min(int(frame), self.frames - 1)
        share = min(frame - first, 1.0)
        there = [(n, line, first - line.start) for n, line in self._lines.items() if line.has(first)]
        places = _rows([line.positions[3 * k : 3 * k + 3] for _, line, k in there], 3)
        quats = _rows([line.quats[4 * k : 4 * k + 4] for _, line, k in there], 4)
        if share > 0:
            then = [(line, min(k + 1, line.count - 1)) for _, line, k in there]
            places = (1 - share) * places + share * _rows([line.positions[3 * k : 3 * k + 3] for line, k in then], 3)
            quats = nlerp(quats, _rows([line.quats[4 * k : 4 * k + 4] for line, k in then], 4), share)
        return [
            Pose(n, line.name, line.kind, line.mesh, line.source, line.whole, place, quat)
            for (n, line, _), place, quat in zip(there, places, quats, strict=True)
        ]

    def mesh(self, name: str) -> Mesh:
        """The mesh of a body that is there, or was."""
        return next(line.mesh for line in self._lines.values() if line.name == name)

    def recording(self) -> Recording:
        tracks = [
            Track(
                line.name,
                line.kind,
                line.mesh,
                line.source,
                line.start,
                _rows([line.positions], 3),
                _rows([line.quats], 4),
                line.whole,
                line.rigid(),
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
        turn = rotation_matrix(np.asarray(placed.quat_wxyz)).T
        similarity = np.eye(4)
        similarity[:3, :3] = self._reference.scale * turn
        similarity[:3, 3] = self._reference.to_user(-turn @ np.asarray(placed.position))
        return similarity


def _rows(parts: list[array], width: int) -> Floats:
    """Numbers one after another as rows."""
    return np.frombuffer(b"".join(parts)).reshape(-1, width).copy()


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
