"""Animated binary glTF 2.0: opens in Blender, browsers, game engines."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepfracture._version import __version__
from deepfracture.export.names import body_names
from deepfracture.geometry.rotations import continuous_quats, quat_between, quats_from_matrices
from deepfracture.recording.motion import keys, pivot, pivot_positions, similarity
from deepfracture.recording.surface import METALLIC, ROUGHNESS, Surface, linear, track_surfaces
from deepfracture.runtime.files import atomic_file
from deepfracture.types import Floats, Recording, Track

if TYPE_CHECKING:
    from pygltflib import GLTF2

FLOAT, UINT32, UINT16 = 5126, 5125, 5123
REPEAT = 10497
Y_UP = np.array([0.0, 1.0, 0.0])
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963


def write_glb(recording: Recording, path: str | os.PathLike) -> None:
    """Write every body as an animated node, in the user's coordinates turned y-up.

    One node a body (fragments: fragment_000 ...) about its centre of mass, translation and rotation sampled at the
    recording's frames; a body that does not exist yet, or no longer, has scale 0, which
    glTF 2.0 (section 3.5.3) lets a renderer skip. A primitive for each material of the user's
    file, and one for the crack surface: its material is called "inner", and its texture
    coordinates are metres. Nodes have `extras`: their kind, where known their mass [kg], and as `rest` where their
    origin was in the user's unbroken shape; those of the asset are its frame rate and number of frames. The same
    recording gives the same bytes.
    """
    data = _Builder(recording).bytes()
    with atomic_file(path) as temporary:
        temporary.write_bytes(data)


def surface_glb(surface: Surface) -> bytes:
    """A glTF file of one surface, in its own coordinates."""
    builder = _Builder(Recording(1.0, ()))
    g, doc = builder.g, builder.doc
    doc.meshes.append(g.Mesh(primitives=[builder.primitive(surface)]))
    doc.nodes.append(g.Node(mesh=0))
    doc.scenes, doc.scene = [g.Scene(nodes=[0])], 0
    return builder.packed()


class _Builder:
    """One file in the making: the document and its binary chunk grow together."""

    def __init__(self, recording: Recording) -> None:
        import pygltflib as g

        self.g, self.recording = g, recording
        timing = {"frame_rate": round(1 / recording.frame_time, 6), "frames": recording.frames}
        asset = g.Asset(version="2.0", generator=f"deepfracture {__version__}", extras=timing)
        self.doc: GLTF2 = g.GLTF2(asset=asset)
        self.blob = bytearray()
        self.accessors: dict[tuple, int] = {}
        self.materials: dict[tuple, int] = {}
        self.images: dict[bytes, int] = {}
        self.channels: list[Any] = []
        self.samplers: list[Any] = []

    def bytes(self) -> bytes:
        g, doc = self.g, self.doc
        for track, name in zip(self.recording.tracks, body_names(self.recording), strict=True):
            if len(track.positions):  # else it broke before the first frame
                self.body(track, name)
        bodies = list(range(len(doc.nodes)))
        self.roots(bodies)
        if self.channels:
            doc.animations = [g.Animation(name="shatter", channels=self.channels, samplers=self.samplers)]
        return self.packed()

    def packed(self) -> bytes:
        """The whole file."""
        self.doc.buffers = [self.g.Buffer(byteLength=len(self.blob))]
        self.doc.set_binary_blob(bytes(self.blob))
        return b"".join(self.doc.save_to_bytes())

    def roots(self, bodies: list[int]) -> None:
        """y-up <- user (a rotation), user <- world (the recording's similarity)."""
        scale, turn, shift = similarity(self.recording)
        self.doc.nodes.append(
            self.g.Node(
                name="user_from_world",
                children=bodies,
                translation=[float(v) for v in shift],
                rotation=_xyzw(quats_from_matrices(turn)),
                scale=[scale] * 3,
            )
        )
        root = self.g.Node(name="y_up", children=[len(bodies)], rotation=_xyzw(quat_between(turn[:, 2], Y_UP)))
        self.doc.nodes.append(root)
        self.doc.scenes = [self.g.Scene(name="deepfracture", nodes=[len(bodies) + 1])]
        self.doc.scene = 0

    def body(self, track: Track, name: str) -> None:
        """Its mesh, its node and its channels."""
        g, node = self.g, len(self.doc.nodes)
        primitives = [self.primitive(surface, pivot(track)) for surface in track_surfaces(track)]
        self.doc.meshes.append(g.Mesh(name=name, primitives=primitives))
        places, quats = pivot_positions(track), continuous_quats(track.quats_wxyz)
        self.doc.nodes.append(
            g.Node(
                name=name,
                extras=_extras(track),
                mesh=len(self.doc.meshes) - 1,
                translation=[float(v) for v in places[0]],
                rotation=_xyzw(quats[0]),
                scale=[1.0 if track.start == 0 else 0.0] * 3,
            )
        )
        self.channel(node, "translation", places, track.start)
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

    def primitive(self, surface: Surface, pivot: Floats | None = None) -> Any:
        g = self.g
        places = surface.vertices if pivot is None else (surface.vertices - pivot).astype(np.float32)
        position = self.accessor(places, "VEC3", FLOAT, VERTEX_BUFFER, bounds=True)
        normal = self.accessor(surface.normals, "VEC3", FLOAT, VERTEX_BUFFER)
        index = self.accessor(surface.faces.ravel().astype(np.uint32), "SCALAR", UINT32, INDEX_BUFFER)
        attributes = g.Attributes(POSITION=position, NORMAL=normal)
        if surface.uv is not None:
            # glTF counts v downwards from the top of the picture
            down = np.stack([surface.uv[:, 0], 1 - surface.uv[:, 1]], axis=1)
            attributes.TEXCOORD_0 = self.accessor(down.astype(np.float32), "VEC2", FLOAT, VERTEX_BUFFER)
        if surface.colours is not None:
            attributes.COLOR_0 = self.accessor(_light(surface.colours), "VEC4", UINT16, VERTEX_BUFFER, normalised=True)
        return g.Primitive(attributes=attributes, indices=index, material=self.material(surface))

    def material(self, surface: Surface) -> int:
        """One for each finish of each look."""
        g, texture = self.g, surface.finish.texture if surface.uv is not None else None
        key = (surface.look, surface.name, surface.base, texture)
        if key not in self.materials:
            base = [round(float(linear(c / 255)), 4) for c in surface.base]
            shading = g.PbrMetallicRoughness(
                baseColorFactor=[*base, 1.0],
                metallicFactor=METALLIC.get(surface.look, 0.0),
                roughnessFactor=ROUGHNESS[surface.look],
            )
            if texture is not None:
                shading.baseColorTexture = g.TextureInfo(index=self.texture(texture))
            self.materials[key] = len(self.doc.materials)
            self.doc.materials.append(g.Material(name=surface.name, pbrMetallicRoughness=shading))
        return self.materials[key]

    def texture(self, picture: bytes) -> int:
        """Index of a texture that repeats a PNG or JPEG file, which is stored once."""
        if picture not in self.images:
            g, doc = self.g, self.doc
            doc.bufferViews.append(g.BufferView(buffer=0, byteOffset=len(self.blob), byteLength=len(picture)))
            self.blob += picture + bytes(-len(picture) % 4)
            kind = "image/png" if picture.startswith(b"\x89PNG") else "image/jpeg"
            doc.images.append(g.Image(bufferView=len(doc.bufferViews) - 1, mimeType=kind))
            doc.samplers = [g.Sampler(wrapS=REPEAT, wrapT=REPEAT)]
            self.images[picture] = len(doc.textures)
            doc.textures.append(g.Texture(sampler=0, source=len(doc.images) - 1))
        return self.images[picture]

    def accessor(
        self,
        values: NDArray,
        kind: str,
        component: int,
        target: int | None = None,
        *,
        bounds: bool = False,
        normalised: bool = False,
    ) -> int:
        """Index of an accessor over `values`; equal values are stored once."""
        data = np.ascontiguousarray(values).tobytes()
        key = (data, kind, component, target, bounds)
        if key not in self.accessors:
            g, rows = self.g, values.reshape(len(values), -1)
            view = g.BufferView(buffer=0, byteOffset=len(self.blob), byteLength=len(data), target=target)
            self.doc.bufferViews.append(view)
            self.blob += data  # every row is a multiple of 4 bytes wide: the next view stays aligned
            accessor = g.Accessor(
                bufferView=len(self.doc.bufferViews) - 1,
                componentType=component,
                type=kind,
                count=len(values),
                normalized=normalised,
            )
            if bounds:
                accessor.min = [float(v) for v in rows.min(axis=0)]
                accessor.max = [float(v) for v in rows.max(axis=0)]
            self.accessors[key] = len(self.doc.accessors)
            self.doc.accessors.append(accessor)
        return self.accessors[key]


def _light(colours: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Colours (n, 4) as the linear light that glTF wants; eight bits would band in the shadows."""
    values = colours / 255
    values[:, :3] = linear(values[:, :3])
    return np.rint(65535 * values).astype(np.uint16)


def _extras(track: Track) -> dict[str, Any]:
    """What a node says of its body."""
    extras: dict[str, Any] = {"kind": track.kind}
    if track.rigid is not None:
        extras["mass"] = track.rigid.mass
    if track.whole is not None:
        extras["rest"] = track.whole.to_user(pivot(track)).tolist()
    return extras


def _xyzw(quat_wxyz: NDArray) -> list[float]:
    return [float(v) for v in np.asarray(quat_wxyz)[[1, 2, 3, 0]]]
