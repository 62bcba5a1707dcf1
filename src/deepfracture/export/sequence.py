"""A mesh for every frame, for programs that read no animation: OBJ or PLY."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deepfracture.export.meshes import texels
from deepfracture.export.names import body_names
from deepfracture.export.wavefront import material_lines, picture_name
from deepfracture.geometry.rotations import continuous_quats, rotation_matrices, slerp
from deepfracture.recording.motion import pivot, pivot_positions, similarity
from deepfracture.recording.surface import Surface, track_surfaces
from deepfracture.runtime.files import atomic_folder
from deepfracture.runtime.progress import track as with_progress
from deepfracture.types import BadInput, Floats, Ints, Recording, Track

LIBRARY = "materials.mtl"
NEAR = 1e-9
"""Of a frame: times that differ by less are one."""


def write_sequence(
    recording: Recording, folder: str | os.PathLike, *, kind: str = "obj", rate: float = 24.0
) -> list[Path]:
    """Write frame_0000.obj ... or frame_0000.ply ... into `folder`, which appears whole or not at all.

    Each file holds all bodies that exist then, but the floor, in the user's coordinates. Of a body the faces and
    their order never change.

    obj: an object for each body (fragment_000 ...), its material groups, texture coordinates and normals; closed.
    Materials and textures lie beside.
    ply: one binary mesh, split along creases and seams; vertices have normals, texture coordinates (s, t) and
    colours, faces an int property `body`, which comments in the header name.

    Args:
        recording: What happened.
        folder: Where to; a former one is replaced.
        kind: obj or ply.
        rate: Frames a second; between the recorded ones a body's centre of mass goes straight.

    Returns the paths of the frames. BadInput for another kind or rate."""
    if kind not in WRITERS:
        raise BadInput(f"kind must be {' or '.join(WRITERS)}, got {kind!r}")
    if not 0 < rate < np.inf:
        raise BadInput(f"rate must be positive and finite, got {rate}")
    folder = Path(folder)
    bodies = _bodies(recording)
    names = [f"frame_{k:04d}.{kind}" for k in range(int(recording.duration * rate + NEAR) + 1)]
    with atomic_folder(folder) as temporary:
        write, finish = WRITERS[kind](bodies, temporary)
        for number, name in enumerate(with_progress(names, name=f"write {kind} sequence")):
            time = number / rate / recording.frame_time
            (temporary / name).write_bytes(write([body for body in bodies if body.exists(time)], time))
        finish()
    return [folder / name for name in names]


@dataclass(frozen=True, eq=False)
class _Body:
    """One body, and how its points get where they are at a time in frames."""

    name: str
    number: int
    track: Track
    parts: tuple[Surface, ...]
    used: Ints
    """The vertices of the mesh that its faces have, ascending, shape (k,)."""
    places: Floats
    """Of the pivot in the world, shape (n, 3)."""
    quats: Floats
    user: tuple[float, Floats, Floats]

    def exists(self, time: float) -> bool:
        return self.track.start <= time + NEAR < self.track.stop

    def pose(self, time: float) -> tuple[Floats, Floats]:
        """Rotation (3, 3) and place (3,) of the pivot in the user's coordinates."""
        at = np.clip(time - self.track.start, 0, len(self.places) - 1)
        low = min(int(at + NEAR), len(self.places) - 1)
        share, high = at - low, min(low + 1, len(self.places) - 1)
        place = (1 - share) * self.places[low] + share * self.places[high]
        turn = rotation_matrices(slerp(self.quats[low], self.quats[high], share))
        scale, rotation, shift = self.user
        return rotation @ turn, scale * rotation @ place + shift

    def moved(self, points: NDArray, time: float) -> Floats:
        turn, place = self.pose(time)
        return self.user[0] * (points - pivot(self.track)) @ turn.T + place

    def turned(self, normals: NDArray, time: float) -> Floats:
        return normals @ self.pose(time)[0].T


def _bodies(recording: Recording) -> list[_Body]:
    bodies = []
    user = similarity(recording)
    for name, track in zip(body_names(recording), recording.tracks, strict=True):
        if track.kind == "floor" or not len(track.positions):
            continue
        parts = track_surfaces(track)
        used = np.unique(np.concatenate([part.origin for part in parts]))
        quats = continuous_quats(track.quats_wxyz)
        bodies.append(_Body(name, len(bodies), track, parts, used, pivot_positions(track), quats, user))
    return bodies


Writer = Callable[[list[_Body], float], bytes]


def _obj(bodies: list[_Body], folder: Path) -> tuple[Writer, Callable[[], None]]:
    """Each body's faces count backwards from its own last vertex, so their text is made once."""
    library = _Library(folder)
    fixed = {body.number: _obj_fixed(body, library) for body in bodies}
    still: dict[int, tuple[bytes, str]] = {}

    def write(there: list[_Body], time: float) -> bytes:
        blocks = [f"mtllib {LIBRARY}\n"]
        for body in there:
            pose = b"".join(part.tobytes() for part in body.pose(time))
            if still.get(body.number, (b"", ""))[0] != pose:
                still[body.number] = pose, _obj_block(body, time, *fixed[body.number])
            blocks.append(still[body.number][1])
        return "".join(blocks).encode()

    return write, library.write


def _obj_block(body: _Body, time: float, coordinates: str, faces: str) -> str:
    normals = np.concatenate([body.turned(part.normals, time) for part in body.parts])
    places = body.moved(body.track.mesh.vertices[body.used], time)
    return f"o {body.name}\n{_rows('v', '%.9g', places)}{coordinates}{_rows('vn', '%.5f', normals)}{faces}"


def _obj_fixed(body: _Body, library: _Library) -> tuple[str, str]:
    """The lines of a body's texture coordinates and of its faces."""
    coordinates, lines = [], []
    corners = sum(len(part.vertices) for part in body.parts)
    spots = sum(len(part.vertices) for part in body.parts if part.uv is not None)
    first = spot = 0
    for part in body.parts:
        lines.append(f"usemtl {library.name(part)}\n")
        vertex = np.searchsorted(body.used, part.origin[part.faces]) - len(body.used)
        normal = part.faces + first - corners
        if part.uv is None:
            columns, form = (vertex, normal), "%d//%d"
        else:
            columns, form = (vertex, part.faces + spot - spots, normal), "%d/%d/%d"
            coordinates.append(_rows("vt", "%.6f", part.uv))
            spot += len(part.vertices)
        table = np.stack(columns, axis=-1).reshape(len(part.faces), -1)
        lines.append((f"f {form} {form} {form}\n" * len(table)) % tuple(table.ravel().tolist()))
        first += len(part.vertices)
    return "".join(coordinates), "".join(lines)


def _rows(key: str, form: str, values: NDArray) -> str:
    line = f"{key} {' '.join([form] * values.shape[1])}\n"
    return (line * len(values)) % tuple(values.ravel().tolist())


class _Library:
    """The materials of a sequence, each once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names: dict[tuple, str] = {}
        self._pictures: dict[bytes, str] = {}
        self._lines: list[str] = []

    def name(self, part: Surface) -> str:
        texture = part.finish.texture if part.uv is not None else None
        key = (part.look, part.name, part.base, texture)
        if key not in self._names:
            name = "_".join(part.name.split())
            name = f"{name}_{len(self._names)}" if name in self._names.values() else name
            self._names[key] = name
            self._lines += material_lines(name, part.base)
            if texture is not None:
                picture = self._pictures.setdefault(texture, picture_name(len(self._pictures), texture))
                self._lines.append(f"map_Kd {picture}")
        return self._names[key]

    def write(self) -> None:
        for data, name in self._pictures.items():
            (self._folder / name).write_bytes(data)
        (self._folder / LIBRARY).write_text("\n".join(self._lines) + "\n", encoding="utf-8")


PLY_VERTEX = np.dtype([("place", "<f4", 3), ("normal", "<f4", 3), ("uv", "<f4", 2), ("colour", "u1", 3)])
PLY_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3), ("body", "<i4")])
PLY_HEADER = """ply
format binary_little_endian 1.0
{comments}element vertex {vertices}
property float x
property float y
property float z
property float nx
property float ny
property float nz
property float s
property float t
property uchar red
property uchar green
property uchar blue
element face {faces}
property list uchar int vertex_indices
property int body
end_header
"""


def _ply(bodies: list[_Body], folder: Path) -> tuple[Writer, Callable[[], None]]:
    fixed = {body.number: [_ply_fixed(body, part) for part in body.parts] for body in bodies}

    def write(there: list[_Body], time: float) -> bytes:
        vertices, faces, count = [], [], 0
        for body in there:
            for part, (points, corners) in zip(body.parts, fixed[body.number], strict=True):
                points, corners = points.copy(), corners.copy()
                points["place"] = body.moved(part.vertices, time)
                points["normal"] = body.turned(part.normals, time)
                corners["corners"] += count
                count += len(points)
                vertices.append(points.tobytes())
                faces.append(corners.tobytes())
        comments = "".join(f"comment body {body.number} {body.name}\n" for body in there)
        total = sum(map(len, faces)) // PLY_FACE.itemsize
        header = PLY_HEADER.format(comments=comments, vertices=count, faces=total)
        return b"".join([header.encode(), *vertices, *faces])

    return write, lambda: None


def _ply_fixed(body: _Body, part: Surface) -> tuple[NDArray, NDArray]:
    """Vertices and faces of a surface, with all that does not move."""
    vertices, faces = np.zeros(len(part.vertices), PLY_VERTEX), np.empty(len(part.faces), PLY_FACE)
    faces["count"], faces["corners"], faces["body"] = 3, part.faces, body.number
    if part.uv is not None:
        vertices["uv"] = part.uv
    tint = np.tile(np.array(part.base, float), (len(vertices), 1))
    if part.uv is not None and part.finish.texture is not None:
        tint *= texels(part.finish.texture, part.uv) / 255
    if part.colours is not None:
        tint *= part.colours[:, :3] / 255
    vertices["colour"] = np.rint(tint)
    return vertices, faces


WRITERS = {"obj": _obj, "ply": _ply}
