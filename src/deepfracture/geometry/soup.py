"""The triangles of a mesh file as they are written there, with what their corners are painted with."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepfracture.geometry.textures import folder_resolver, to_texture
from deepfracture.types import Appearance, BadInput, Finish, Floats, Ints

if TYPE_CHECKING:
    import trimesh

GLTF = (".glb", ".gltf")
"""Files whose colours are linear light."""
MAX_VERTICES = 50_000_000
"""Vertices that a glTF file may blow itself up to."""


@dataclass(frozen=True, eq=False)
class TriangleSoup:
    """What a file says. What is None, it does not have."""

    vertices: Floats
    """Shape (n, 3)."""
    faces: Ints
    """Shape (m, 3)."""
    finish: Ints
    """Index in `finishes`, shape (m,)."""
    finishes: tuple[Finish, ...]
    normals: Floats | None = None
    """Of the corners, of any length, zero where the file has none, shape (m, 3, 3)."""
    uv: Floats | None = None
    """Of the corners, v upward, shape (m, 3, 2)."""
    colours: Floats | None = None
    """Of the corners, sRGB and opacity 0..1, shape (m, 3, 4)."""

    def appearance(self) -> Appearance | None:
        """None if the file says nothing of how the mesh looks. Raises BadInput for NaN."""
        painted = len(self.finishes) > 1 or any(f.name or f.colour or f.texture for f in self.finishes)
        if not painted and self.normals is None and self.uv is None and self.colours is None:
            return None
        normals = None if self.normals is None else self._unit_normals(self.normals)
        uv = None if self.uv is None else self.uv.astype(np.float32)
        colours = None if self.colours is None else np.rint(255 * self.colours).astype(np.uint8)
        return Appearance(self.finish.astype(np.int32), self.finishes, normals, uv, colours)

    def _unit_normals(self, normals: Floats) -> NDArray[np.float32]:
        """Unit normals; where the file has none, those of the faces."""
        if not np.isfinite(normals).all():
            raise BadInput("normals must be finite, got NaN or infinite values")
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        flat = np.cross(b - a, c - a)[:, None]
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        normals = np.where(length < 1e-6, flat, normals)
        length = np.where(length < 1e-6, np.linalg.norm(flat, axis=2, keepdims=True), length)
        up = np.array([0.0, 0.0, 1.0])
        return np.where(length > 0, normals / np.where(length > 0, length, 1), up).astype(np.float32)


def read_scene(path: Path) -> TriangleSoup:
    """Every triangle of a STL, PLY, GLB, GLTF or OFF file, scene nodes in place. Raises BadInput in one line.

    What a file names beside itself is read from its own folder only."""
    import logging

    import trimesh

    # trimesh reports what it skips to its own logger; our one line says enough.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        if path.suffix.lower() in GLTF:
            _check_declared_size(path)
        scene = trimesh.load_scene(path, process=False, resolver=folder_resolver(path))
        looks = {
            name: _part_appearance(mesh, path)
            for name, mesh in scene.geometry.items()
            if isinstance(mesh, trimesh.Trimesh)
        }
        placed = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
        frames = [scene.graph[mesh.metadata["node"]][0][:3, :3] for mesh in placed]
        return _merge(placed, [looks[mesh.metadata["name"]] for mesh in placed], frames)
    except Exception as problem:  # Loaders raise anything on garbage; every case is the same to the user.
        reason = (str(problem).strip().splitlines() or [type(problem).__name__])[0][:200]
        raise BadInput(f"{path}: not a readable {path.suffix[1:].upper()} file ({reason})") from None


def _check_declared_size(path: Path) -> None:
    """Raises ValueError where a small glTF file would become a large mesh: blank arrays and copies cost it nothing."""
    data = path.read_bytes()
    if data[:4] == b"glTF":  # glTF 2.0, 4.4: 12 bytes, then the length of the JSON chunk and its kind
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    tree = json.loads(data)
    counts = [int(accessor.get("count", 0)) for accessor in tree.get("accessors", ())]
    blank = sum(n for n, a in zip(counts, tree.get("accessors", ()), strict=True) if a.get("bufferView") is None)
    parts = [mesh.get("primitives", ()) for mesh in tree.get("meshes", ())]
    sizes = [sum(counts[p["attributes"]["POSITION"]] for p in part if "POSITION" in p["attributes"]) for part in parts]
    copies = sum(sizes[node["mesh"]] for node in tree.get("nodes", ()) if 0 <= node.get("mesh", -1) < len(sizes))
    if max(blank, copies) > MAX_VERTICES:
        raise ValueError(f"{max(blank, copies)} vertices, {MAX_VERTICES} at most")


@dataclass(frozen=True, eq=False)
class _PartAppearance:
    """Of one part of a scene: by vertex, or by face where `by_face`."""

    finish: Finish
    normals: Floats | None
    uv: Floats | None
    colours: Floats | None
    by_face: bool = False
    """Whether colours are those of faces."""


def _part_appearance(mesh: trimesh.Trimesh, path: Path) -> _PartAppearance:
    visual: Any = mesh.visual
    normals = np.array(mesh.vertex_normals, float) if "vertex_normals" in mesh._cache else None
    if visual.kind in ("vertex", "face"):
        values = visual.vertex_colors if visual.kind == "vertex" else visual.face_colors
        return _PartAppearance(Finish(), normals, None, _srgb(np.asarray(values), path), visual.kind == "face")
    if visual.kind != "texture":
        return _PartAppearance(Finish(), normals, None, None)
    uv = None if visual.uv is None else np.asarray(visual.uv, float)
    colours = visual.vertex_attributes.get("color", _ply_colours(mesh))
    finish = _finish(visual.material, path, uv is not None)
    return _PartAppearance(finish, normals, uv, None if colours is None else _srgb(np.asarray(colours), path))


def _finish(material: Any, path: Path, mapped: bool) -> Finish:
    """The name, colour and picture of a material of trimesh's, of either kind."""
    picture = getattr(material, "baseColorTexture", getattr(material, "image", None))
    name = material.name if isinstance(getattr(material, "name", None), str) else ""
    colour = getattr(material, "baseColorFactor", None)
    base = None
    if colour is not None:
        red, green, blue = np.rint(255 * _srgb(np.asarray(colour)[None, :3], path)[0, :3]).astype(int).tolist()
        base = red, green, blue
    return Finish(name, base, _texture_bytes(picture, path) if picture is not None and mapped else None)


def _texture_bytes(picture: Any, path: Path) -> bytes | None:
    """The file that a picture was opened from, as it was written; None if it is trimesh's own blank."""
    if getattr(picture, "fp", None) is None:
        return None
    picture.fp.seek(0)
    return to_texture(picture.fp.read(), str(path))


def _ply_colours(mesh: trimesh.Trimesh) -> NDArray | None:
    """Vertex colours (n, 3) of a PLY file that has texture coordinates too: trimesh passes them over."""
    from scipy.spatial import KDTree

    raw: Any = mesh.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    if raw is None:
        return None
    names = getattr(getattr(raw, "dtype", None), "names", None) or tuple(raw)  # an array with fields, or a dict
    if not {"red", "green", "blue"} <= set(names):
        return None
    places, colours = (np.column_stack([np.ravel(raw[k]) for k in keys]) for keys in ("xyz", ("red", "green", "blue")))
    return colours[KDTree(places).query(mesh.vertices)[1]]


def _srgb(colours: NDArray, path: Path) -> Floats:
    """Colours (n, 3 or 4) of any type as sRGB and opacity 0..1, shape (n, 4)."""
    most = np.iinfo(colours.dtype).max if colours.dtype.kind in "ui" else 1
    values = np.ones((len(colours), 4))
    values[:, : colours.shape[1]] = np.clip(colours / most, 0, 1)
    if path.suffix.lower() in GLTF:  # glTF 2.0, 3.7.2.1 and 3.9.2: linear; IEC 61966-2-1 encodes it
        light = values[:, :3]
        values[:, :3] = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return values


def _merge(placed: list[trimesh.Trimesh], looks: list[_PartAppearance], frames: list[Floats]) -> TriangleSoup:
    """All parts as one; what only some have, the others have blank."""
    if not placed:
        return TriangleSoup(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros(0, np.int64), (Finish(),))
    counts = [len(mesh.vertices) for mesh in placed]
    starts = np.cumsum([0, *counts[:-1]])
    faces = [np.asarray(mesh.faces, np.int64).reshape(-1, 3) for mesh in placed]
    finishes = list({id(look.finish): look.finish for look in looks}.values())
    finish = [np.full(len(own), finishes.index(look.finish)) for own, look in zip(faces, looks, strict=True)]
    normals = [_transform_normals(look.normals, frame) for look, frame in zip(looks, frames, strict=True)]
    return TriangleSoup(
        np.concatenate([np.asarray(mesh.vertices, float) for mesh in placed]).reshape(-1, 3),
        np.concatenate([own + start for own, start in zip(faces, starts, strict=True)]),
        np.concatenate(finish),
        tuple(finishes),
        _corners(normals, faces, [False] * len(placed), np.zeros(3)),
        _corners([look.uv for look in looks], faces, [False] * len(placed), np.zeros(2)),
        _corners([look.colours for look in looks], faces, [look.by_face for look in looks], np.ones(4)),
    )


def _transform_normals(normals: Floats | None, frame: Floats) -> Floats | None:
    """Normals (n, 3) of a part that stands in the scene by the matrix `frame` (3, 3), which may scale and shear."""
    if normals is None:
        return None
    x, y, z = frame.T
    # The cofactors of the matrix, which flat ones have too.
    return normals @ np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)])


def _corners(values: list[Any], faces: list[Ints], by_face: list[bool], blank: Floats) -> Floats | None:
    """Values of each corner (m, 3, c) from those of vertices or faces; None where no part has any."""
    if all(value is None for value in values):
        return None
    parts = []
    for value, own, whole in zip(values, faces, by_face, strict=True):
        if value is None:
            parts.append(np.broadcast_to(blank, (len(own), 3, len(blank))))
        elif whole:
            parts.append(np.repeat(value[:, None], 3, axis=1))
        else:
            parts.append(value[own])
    return np.concatenate(parts)
