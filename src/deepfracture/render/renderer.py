"""Renders recordings: bodies, lights, floor and camera, one picture a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from deepfracture.geometry.rotations import rotation_matrices
from deepfracture.recording.motion import exists, floor_height
from deepfracture.recording.surface import COLOURS, Surface, track_surfaces
from deepfracture.render.camera import Camera
from deepfracture.types import Floats, Floats32, Recording

if TYPE_CHECKING:
    from deepfracture.render.raster import Lights, Shadows, View

KEY_LIGHT = np.array([-0.45, 0.62, 0.95])
"""Towards the key light, in camera axes: left, towards the viewer, up."""
FILL_LIGHT = np.array([0.85, 0.35, 0.25])
BACKDROP = (246, 244, 241)
GLOSS = {"outer": 0.35, "inner": 0.0, "ball": 1.0, "floor": 0.0, "block": 0.1}
SHADOW_TEXELS, SKY_TEXELS = 640, 256
"""Sides of the shadow maps of the key light and of the sky."""
FLOOR_POINTS = 96
"""Points along one side of the floor at which sky visibility is computed."""
SKY_TAPS = 32
SKY_REACHES = np.array([0.12, 0.35])
"""Reach of the sky's occluders, as shares of the lit region's radius."""
TEXTURE_SIDE = 1024
"""Texels along the longer side of a texture at most: the pictures are smaller than most."""
SHADOW_SOFTNESS = 0.035
"""Radius of a shadow's soft edge, as a share of the lit region's radius."""


@dataclass(frozen=True, eq=False)
class Instance:
    """Surfaces that move together, as one body."""

    surfaces: tuple[Surface, ...]


class Renderer:
    """Holds the triangles of all instances; each picture only moves them."""

    def __init__(
        self,
        instances: Sequence[Instance],
        camera: Camera,
        *,
        size: tuple[int, int],
        samples: int,
        floor: float | None,
        radius: float,
        taps: int = 18,
    ) -> None:
        """size: width, height [pixel]; samples: per pixel and axis; floor: its height [m];
        radius: of the region around the camera's target that casts shadows [m];
        taps: on the key light's soft shadow, more for less grain."""
        from deepfracture.render.raster import encoding

        surfaces = [(b, s) for b, instance in enumerate(instances) for s in instance.surfaces]
        counts = [len(s.vertices) for _, s in surfaces]
        first = np.concatenate([[0], np.cumsum(counts)])[:-1]
        self.vertices = np.concatenate([s.vertices for _, s in surfaces])
        self.normals = np.concatenate([s.normals for _, s in surfaces])
        stop = np.cumsum([sum(len(s.vertices) for s in instance.surfaces) for instance in instances])
        self.parts = [slice(a, b) for a, b in zip([0, *stop[:-1]], stop, strict=True)]
        shifted = [s.faces + k for k, (_, s) in zip(first, surfaces, strict=True)]
        self.faces = np.concatenate(shifted).astype(np.int32)
        faces = [len(s.faces) for _, s in surfaces]
        self.face_body = np.repeat([b for b, _ in surfaces], faces)
        self.looks = np.concatenate([_looks(s) for _, s in surfaces])
        self.uv = np.concatenate(
            [np.zeros((k, 2), np.float32) if s.uv is None else s.uv for k, (_, s) in zip(counts, surfaces, strict=True)]
        )
        self.atlas, number = _atlas([s for _, s in surfaces])
        self.page = np.repeat(number, faces)
        self.patch = _patches(self.faces, len(self.vertices))
        self.encode = encoding()
        self.camera, self.size, self.samples, self.floor, self.radius = camera, size, samples, floor, radius
        self.taps = taps

    def picture(self, rotations: Floats, offsets: Floats, shown: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """RGB picture (h, w, 3) with instance b rotated by rotations[b] and moved by offsets[b], if shown[b]."""
        from deepfracture.render import raster

        vertices, normals = self._placed(rotations, offsets)
        seen = shown[self.face_body]
        faces = self.faces[seen]
        (width, height), s = self.size, self.samples
        view = self._view(height * s)
        lights, shadows, sky = self._lights(vertices, normals, faces)
        looks = np.column_stack([normals, self.looks, sky, self.uv])
        bodies = raster.Bodies(faces, self.patch[seen], looks, self.page[seen], *self.atlas)
        axes, eye = self.camera.axes.astype(np.float32), self.camera.position.astype(np.float32)
        screen, depth, triangle = raster.rasterize(vertices, faces, axes, eye, view.focal, (width * s, height * s))
        out = np.empty((height, width, 3), np.uint8)
        raster.shade(s, depth, triangle, screen, bodies, view, lights, shadows, self.encode, out)
        return out

    def _placed(self, rotations: Floats, offsets: Floats) -> tuple[Floats32, Floats32]:
        """Vertices and normals in the world."""
        vertices, normals = np.empty_like(self.vertices), np.empty_like(self.normals)
        for b, part in enumerate(self.parts):
            turn = rotations[b].T.astype(np.float32)
            vertices[part] = self.vertices[part] @ turn + offsets[b].astype(np.float32)
            normals[part] = self.normals[part] @ turn
        return vertices, normals

    def _view(self, height: int) -> View:
        from deepfracture.render.raster import FAR, View, linear, triple

        camera, one = self.camera, np.float32
        right, up, back = camera.axes
        return View(
            eye=triple(camera.position),
            right=triple(right),
            up=triple(up),
            back=triple(back),
            focal=one(height / 2 / np.tan(np.radians(camera.field / 2))),
            floor=one(-FAR if self.floor is None else self.floor),
            fade=one(2.6 * self.radius),
            floor_colour=triple(linear(COLOURS["floor"])),
            backdrop=triple(linear(BACKDROP)),
        )

    def _lights(
        self, vertices: Floats32, normals: Floats32, faces: NDArray[np.int32]
    ) -> tuple[Lights, Shadows, Floats32]:
        """The lights, their shadow maps, and the share of the sky visible from each vertex."""
        from deepfracture.render.raster import Lights, Shadows, rasterize_parallel, sky_visibility, taps, triple

        one, level = np.float32, level_axes(self.camera)
        key_axes, fill = _light_axes(KEY_LIGHT @ level).astype(one), FILL_LIGHT @ level
        centre, radius = self.camera.target.astype(one), one(self.radius)
        key, sky = (
            rasterize_parallel(vertices, faces, axes, centre, one(texels / (2 * radius)), (texels, texels))
            for axes, texels in ((key_axes, SHADOW_TEXELS), (np.eye(3, dtype=one), SKY_TEXELS))
        )
        axis = np.linspace(-radius, radius, FLOOR_POINTS, dtype=one)
        floor = np.stack(np.meshgrid(axis, axis, [0.0]), axis=-1).reshape(-1, 3).astype(one) + centre
        floor[:, 2] = centre[2] if self.floor is None else self.floor
        points = np.concatenate([vertices, floor])
        upward = np.concatenate([normals, np.tile(np.array([0, 0, 1], one), (len(floor), 1))])
        reaches = (SKY_REACHES * radius).astype(one)
        seen = np.empty(len(points), one)
        sky_visibility(points, upward, sky, centre, radius, reaches, taps(SKY_TAPS), seen)
        right, up, toward = key_axes
        lights = Lights(
            centre=triple(centre),
            radius=radius,
            right=triple(right),
            up=triple(up),
            toward=triple(toward),
            fill=triple(fill / np.linalg.norm(fill)),
            soft=one(SHADOW_SOFTNESS * radius),
        )
        floor_sky = seen[len(vertices) :].reshape(FLOOR_POINTS, FLOOR_POINTS)
        return lights, Shadows(key, floor_sky, taps(self.taps)), seen[: len(vertices)]


class RecordingRenderer:
    """Renders a recording: pictures by frame number."""

    def __init__(
        self, recording: Recording, camera: Camera, *, size: tuple[int, int], samples: int, taps: int = 18
    ) -> None:
        self.tracks = [t for t in recording.tracks if t.kind != "floor" and len(t.positions)]
        reach = float(np.linalg.norm(camera.position - camera.target) * np.tan(np.radians(camera.field / 2)))
        self.renderer = Renderer(
            [Instance(track_surfaces(track)) for track in self.tracks],
            camera,
            size=size,
            samples=samples,
            floor=floor_height(recording),
            radius=1.6 * reach * max(1.0, size[0] / size[1] / 1.3),
            taps=taps,
        )

    def picture(self, frame: int) -> NDArray[np.uint8]:
        """RGB (h, w, 3)."""
        rotations, offsets = np.tile(np.eye(3), (len(self.tracks), 1, 1)), np.zeros((len(self.tracks), 3))
        shown = np.array([exists(track, frame) for track in self.tracks])
        for b in np.flatnonzero(shown):
            track = self.tracks[b]
            rotations[b] = rotation_matrices(track.quats_wxyz[frame - track.start])
            offsets[b] = track.positions[frame - track.start]
        return self.renderer.picture(rotations, offsets, shown)


def level_axes(camera: Camera) -> Floats:
    """Rows right, towards the viewer, up (3, 3): lights follow the camera, but not its tilt."""
    right, up = camera.axes[0], np.array([0.0, 0.0, 1.0])
    return np.stack([right, np.cross(right, up), up])


def _light_axes(toward: Floats) -> Floats:
    back = toward / np.linalg.norm(toward)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def _looks(surface: Surface) -> Floats32:
    """Linear colour and gloss of each vertex, shape (n, 4)."""
    from deepfracture.render.raster import linear

    looks = np.empty((len(surface.vertices), 4), np.float32)
    looks[:, :3], looks[:, 3] = linear(surface.base), GLOSS[surface.look]
    if surface.colours is not None:
        looks[:, :3] *= linear(surface.colours[:, :3])
    return looks


def _atlas(surfaces: Sequence[Surface]) -> tuple[tuple[NDArray, NDArray, NDArray], NDArray[np.int32]]:
    """Pages, texels and decoding of `raster.Bodies` for all textures, and the page of each surface, -1 for none."""
    import io

    from PIL import Image

    from deepfracture.render.raster import linear

    files = [s.finish.texture if s.uv is not None else None for s in surfaces]
    known = {file: k for k, file in enumerate(dict.fromkeys(file for file in files if file is not None))}
    pages, texels, start = [], [np.zeros((0, 3), np.uint8)], 0
    for file in known:
        with Image.open(io.BytesIO(file)) as picture:
            picture.thumbnail((TEXTURE_SIDE, TEXTURE_SIDE))
            rows = np.asarray(picture.convert("RGB"))
        pages.append((start, rows.shape[1], rows.shape[0]))
        texels.append(rows.reshape(-1, 3))
        start += rows.shape[0] * rows.shape[1]
    number = np.array([-1 if file is None else known[file] for file in files], np.int32)
    atlas = np.array(pages, np.int32).reshape(-1, 3), np.concatenate(texels), linear(np.arange(256))
    return atlas, number


def _patches(faces: NDArray[np.int32], vertices: int) -> NDArray[np.int32]:
    """Number of the connected surface of each face (m,): surfaces are split where they crease."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    first, second = np.concatenate([faces[:, :2], faces[:, 1:]]).T
    links = coo_matrix((np.ones(len(first), np.int8), (first, second)), (vertices, vertices))
    return connected_components(links, directed=False)[1][faces[:, 0]].astype(np.int32)
