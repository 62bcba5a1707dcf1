"""Records the pose of every body, frame by frame."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from deepfracture.geometry.rotations import nlerp, rotation_matrix
from deepfracture.types import Floats, Ints, Mesh, Recording, Rigid, Shape, Track
from deepfracture.world.engine import BodyState
from deepfracture.world.rigid_body import RigidBody, block_state
from deepfracture.world.scene import Scene

FLOOR_HALF = 6.0
"""Half the side of the floor's mesh [m]."""
FLOOR_THICKNESS = 0.1
"""Of the floor's mesh [m]."""


class Pose(NamedTuple):
    """The pose of a body, with how it looks."""

    number: int
    """Unique to the body."""
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
class _BodyTrack:
    body: RigidBody
    mesh: Mesh
    start: int
    # Flat arrays of numbers: a numpy array for each frame takes four times the memory.
    positions: array = field(default_factory=lambda: array("d"))
    quats: array = field(default_factory=lambda: array("d"))
    velocities: array = field(default_factory=lambda: array("d"))
    angular_velocities: array = field(default_factory=lambda: array("d"))

    def add(self, state: BodyState) -> None:
        """One more frame."""
        self.positions.frombytes(np.asarray(state.position, float).tobytes())
        self.quats.frombytes(np.asarray(state.quat_wxyz, float).tobytes())
        self.velocities.frombytes(np.asarray(state.velocity, float).tobytes())
        self.angular_velocities.frombytes(np.asarray(state.angular_velocity, float).tobytes())

    @property
    def count(self) -> int:
        """Frames so far in which the body exists."""
        return len(self.positions) // 3

    def exists_at(self, frame: int) -> bool:
        return 0 <= frame - self.start < self.count

    def pose(self, position: Floats, quat_wxyz: Floats) -> Pose:
        body = self.body
        return Pose(body.number, body.name, body.kind, self.mesh, body.source, body.whole, position, quat_wxyz)

    def track(self) -> Track:
        body, mass = self.body, self.body.mass
        velocities, angular_velocities = _rows([self.velocities], 3), _rows([self.angular_velocities], 3)
        rigid = Rigid(mass.mass, mass.centre, mass.inertia, velocities, angular_velocities, body.hulls)
        positions, quats = _rows([self.positions], 3), _rows([self.quats], 4)
        return Track(body.name, body.kind, self.mesh, body.source, self.start, positions, quats, body.whole, rigid)


class Recorder:
    """Collects frames; `recording` makes them a `Recording`."""

    def __init__(self, scene: Scene, reference: Shape) -> None:
        self._scene = scene
        self._reference = reference
        self.frame_time = 1 / scene.frame_rate
        """Seconds between frames."""
        self._tracks: dict[int, _BodyTrack] = {}
        self.frames = 0
        """Frames recorded so far."""

    def record(self, moving: list[tuple[RigidBody, BodyState]]) -> None:
        """One frame, with all moving bodies."""
        for body, state in moving:
            if body.number not in self._tracks:
                mesh = body.mesh if body.mesh is not None else ball_mesh(body.radius)
                self._tracks[body.number] = _BodyTrack(body, mesh, self.frames)
            self._tracks[body.number].add(state)
        self.frames += 1

    def poses(self, frame: float) -> list[Pose]:
        """Poses of all moving bodies at a frame, interpolated between two frames."""
        first = min(int(frame), self.frames - 1)
        t = min(frame - first, 1.0)
        there = [(track, first - track.start) for track in self._tracks.values() if track.exists_at(first)]
        positions = _rows([track.positions[3 * k : 3 * k + 3] for track, k in there], 3)
        quats = _rows([track.quats[4 * k : 4 * k + 4] for track, k in there], 4)
        if t > 0:
            following = [(track, min(k + 1, track.count - 1)) for track, k in there]
            ends = _rows([track.positions[3 * k : 3 * k + 3] for track, k in following], 3)
            positions = (1 - t) * positions + t * ends
            quats = nlerp(quats, _rows([track.quats[4 * k : 4 * k + 4] for track, k in following], 4), t)
        return [track.pose(*pose) for (track, _), *pose in zip(there, positions, quats, strict=True)]

    def mesh(self, name: str) -> Mesh:
        """The mesh of a body that is or was there."""
        return next(track.mesh for track in self._tracks.values() if track.body.name == name)

    def recording(self) -> Recording:
        tracks = [track.track() for track in self._tracks.values()]
        if self._scene.floor is not None:
            position = np.array([0.0, 0.0, self._scene.floor.height])
            tracks.append(self._fixed("floor", "floor", floor_mesh(), position, np.array([1.0, 0.0, 0.0, 0.0])))
        for i, block in enumerate(self._scene.blocks):
            state, mesh = block_state(block), block_mesh(block.half_sides)
            tracks.append(self._fixed(f"block{i}", "block", mesh, state.position, state.quat_wxyz))
        return Recording(self.frame_time, tuple(tracks), self._user_from_world())

    def _fixed(self, name: str, kind: str, mesh: Mesh, position: Floats, quat: Floats) -> Track:
        positions, quats = np.tile(position, (self.frames, 1)), np.tile(quat, (self.frames, 1))
        return Track(name, kind, mesh, None, 0, positions, quats)

    def _user_from_world(self) -> Floats:
        """Similarity that takes the first shape at the start back to where its file has it."""
        placed = self._scene.shapes[0]
        turn = rotation_matrix(np.asarray(placed.quat_wxyz)).T
        similarity = np.eye(4)
        similarity[:3, :3] = self._reference.scale * turn
        similarity[:3, 3] = self._reference.to_user(-turn @ np.asarray(placed.position))
        return similarity


def _rows(parts: list[array], width: int) -> Floats:
    """Flat arrays as the rows of one."""
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
