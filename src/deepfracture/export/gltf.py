"""Animated binary glTF 2.0: opens in Blender, browsers, game engines."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..types import Recording, Track
from .files import replacing
from .motion import continuous, keys, quat_of
from .surface import COLOURS, Surface, track_surfaces

if TYPE_CHECKING:
    from pygltflib import GLTF2

FLOAT, UINT32 = 5126, 5125
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
ROUGHNESS = {"outer": 0.75, "inner": 0.95, "ball": 0.35, "floor": 0.9, "block": 0.8}


def write_glb(recording: Recording, path: str | os.PathLike) -> None:
    """Write every body as an animated node, in the user's coordinates turned y-up.

    One node a body (fragments: fragment_000 ...), translation and rotation sampled at the
    recording's frames; a body that does not exist yet, or no longer, has scale 0, which
    glTF 2.0 (section 3.5.3) lets a renderer skip. The same recording gives the same bytes.
    """
    data = _Builder(recording).bytes()
    with replacing(path) as temporary:
        temporary.write_bytes(data)


class _Builder:
    """One file in the making: the document and its binary chunk grow together."""

    def __init__(self, recording: Recording) -> None:
        import pygltflib as g

        self.g, self.recording = g, recording
        self.doc: GLTF2 = g.GLTF2(asset=g.Asset(version="2.0", generator=f"deepfracture {__version__}"))
        self.blob = bytearray()
        self.accessors: dict[tuple, int] = {}
        self.materials: dict[str, int] = {}
        self.channels: list[Any] = []
        self.samplers: list[Any] = []

    def bytes(self) -> bytes:
        g, doc = self.g, self.doc
        fragment = 0
        for track in self.recording.tracks:
            if not len(track.positions):
                continue  # it broke before the first frame
            name = track.name
            if track.kind == "fragment":
                name, fragment = f"fragment_{fragment:03d}", fragment + 1
            self.body(track, name)
        bodies = list(range(len(doc.nodes)))
        self.roots(bodies)
        if self.channels:
            doc.animations = [g.Animation(name="shatter", channels=self.channels, samplers=self.samplers)]
        doc.buffers = [g.Buffer(byteLength=len(self.blob))]
        doc.set_binary_blob(bytes(self.blob))
        return b"".join(doc.save_to_bytes())

    def roots(self, bodies: list[int]) -> None:
        """y-up <- user (a rotation), user <- world (the recording's similarity)."""
        user = self.recording.user_from_world
        scale = float(np.cbrt(np.linalg.det(user[:3, :3])))
        turn = user[:3, :3] / scale
        self.doc.nodes.append(
            self.g.Node(
                name="user_from_world",
                children=bodies,
                translation=[float(v) for v in user[:3, 3]],
                rotation=_xyzw(quat_of(turn)),
                scale=[scale] * 3,
            )
        )
        root = self.g.Node(name="y_up", children=[len(bodies)], rotation=_xyzw(_y_up_from(turn[:, 2])))
        self.doc.nodes.append(root)
        self.doc.scenes = [self.g.Scene(name="deepfracture", nodes=[len(bodies) + 1])]
        self.doc.scene = 0

    def body(self, track: Track, name: str) -> None:
        """Its mesh, its node and its channels."""
        g, node = self.g, len(self.doc.nodes)
        primitives = [self.primitive(surface) for surface in track_surfaces(track)]
        self.doc.meshes.append(g.Mesh(name=name, primitives=primitives))
        quats = continuous(track.quats_wxyz)
        self.doc.nodes.append(
            g.Node(
                name=name,
                mesh=len(self.doc.meshes) - 1,
                translation=[float(v) for v in track.positions[0]],
                rotation=_xyzw(quats[0]),
                scale=[1.0 if track.start == 0 else 0.0] * 3,
            )
        )
        self.channel(node, "translation", track.positions, track.start)
        self.channel(node, "rotation", quats[:, [1, 2, 3, 0]], track.start)
        self.visibility(node, track)

    def channel(self, node: int, target: str, values: NDArray, start: int) -> None:
        kept = keys(values)
        if len(kept) > 1:
            self.sample(node, target, kept + start, values[kept], "LINEAR")

    def visibility(self, node: int, track: Track) -> None:
        """Scale 1 while the body exists, 0 before and after, in steps."""
        steps = {0: 1.0 if track.start == 0 else 0.0, track.start: 1.0}
        if track.stop < self.recording.frames:
            steps[track.stop] = 0.0
        if len(steps) > 1:
            frames = np.array(sorted(steps))
            values = np.repeat([[steps[frame]] for frame in frames], 3, axis=1)
            self.sample(node, "scale", frames, values, "STEP")

    def sample(self, node: int, target: str, frames: NDArray, values: NDArray, how: str) -> None:
        g = self.g
        seconds = frames * self.recording.frame_time
        time = self.accessor(seconds.astype(np.float32), "SCALAR", FLOAT, bounds=True)
        value = self.accessor(values.astype(np.float32), f"VEC{values.shape[1]}", FLOAT)
        self.samplers.append(g.AnimationSampler(input=time, output=value, interpolation=how))
        which = g.AnimationChannelTarget(node=node, path=target)
        self.channels.append(g.AnimationChannel(sampler=len(self.samplers) - 1, target=which))

    def primitive(self, surface: Surface) -> Any:
        position = self.accessor(surface.vertices, "VEC3", FLOAT, VERTEX_BUFFER, bounds=True)
        normal = self.accessor(surface.normals, "VEC3", FLOAT, VERTEX_BUFFER)
        index = self.accessor(surface.faces.ravel().astype(np.uint32), "SCALAR", UINT32, INDEX_BUFFER)
        return self.g.Primitive(
            attributes=self.g.Attributes(POSITION=position, NORMAL=normal),
            indices=index,
            material=self.material(surface.look),
        )

    def material(self, look: str) -> int:
        if look not in self.materials:
            linear = [((c / 255 + 0.055) / 1.055) ** 2.4 for c in COLOURS[look]]  # IEC 61966-2-1
            surface = self.g.PbrMetallicRoughness(
                baseColorFactor=[round(c, 4) for c in linear] + [1.0],
                metallicFactor=0.6 if look == "ball" else 0.0,
                roughnessFactor=ROUGHNESS[look],
            )
            self.materials[look] = len(self.doc.materials)
            self.doc.materials.append(self.g.Material(name=look, pbrMetallicRoughness=surface))
        return self.materials[look]

    def accessor(
        self, values: NDArray, kind: str, component: int, target: int | None = None, *, bounds: bool = False
    ) -> int:
        """Index of an accessor over `values`; equal values are stored once."""
        data = np.ascontiguousarray(values).tobytes()
        key = (data, kind, component, target, bounds)
        if key not in self.accessors:
            g, rows = self.g, values.reshape(len(values), -1)
            view = g.BufferView(buffer=0, byteOffset=len(self.blob), byteLength=len(data), target=target)
            self.doc.bufferViews.append(view)
            self.blob += data  # every value is 4 bytes wide: the next view stays aligned
            accessor = g.Accessor(
                bufferView=len(self.doc.bufferViews) - 1,
                componentType=component,
                type=kind,
                count=len(values),
            )
            if bounds:
                accessor.min = [float(v) for v in rows.min(axis=0)]
                accessor.max = [float(v) for v in rows.max(axis=0)]
            self.accessors[key] = len(self.doc.accessors)
            self.doc.accessors.append(accessor)
        return self.accessors[key]


def _xyzw(quat_wxyz: NDArray) -> list[float]:
    return [float(v) for v in np.asarray(quat_wxyz)[[1, 2, 3, 0]]]


def _y_up_from(up: NDArray) -> NDArray:
    """Shortest rotation (w, x, y, z) that takes the user's `up` to glTF's +y."""
    axis, cosine = np.cross(up, (0.0, 1.0, 0.0)), up[1]
    if cosine < -1 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    quat = np.array([1 + cosine, *axis])
    return quat / np.linalg.norm(quat)
