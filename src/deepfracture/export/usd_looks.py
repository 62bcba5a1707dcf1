"""Meshes and materials of a USD stage."""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false
# pxr is compiled and says nothing of its types.

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from deepfracture.export.names import identifier, unused
from deepfracture.export.wavefront import picture_name
from deepfracture.recording.surface import METALLIC, ROUGHNESS, Surface, linear
from deepfracture.types import Floats, Floats32

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom, UsdShade


class Looks:
    """The materials of a stage, each once, and the textures that they name."""

    def __init__(self, stage: Usd.Stage, scope: str, folder: str) -> None:
        """`scope` is the path under which materials go, `folder` what textures are relative to, beside the file."""
        self._stage, self._scope, self._folder = stage, scope, folder
        self._materials: dict[tuple, UsdShade.Material] = {}
        self._pictures: dict[bytes, str] = {}

    @property
    def textures(self) -> dict[str, bytes]:
        """What has to lie in the folder."""
        return {name: data for data, name in self._pictures.items()}

    def mesh(self, path: str, parts: Sequence[Surface], own: Callable[[NDArray], Floats], axes: Floats) -> UsdGeom.Mesh:
        """One closed mesh of all surfaces of a body, faces in their order, a subset for each material.

        `own` takes points of their frame to that of the prim, the rotation `axes` (3, 3) their normals."""
        from pxr import UsdGeom, Vt

        mesh = UsdGeom.Mesh.Define(self._stage, path)
        corners = np.concatenate([part.origin[part.faces] for part in parts])
        used, packed = np.unique(corners, return_inverse=True)
        points = np.empty((len(used), 3))
        for part in parts:
            points[np.searchsorted(used, part.origin)] = part.vertices
        placed = Vt.Vec3fArray.FromNumpy(own(points).astype(np.float32))
        normals = np.concatenate([part.normals[part.faces] for part in parts]).reshape(-1, 3) @ axes.T
        mesh.CreatePointsAttr(placed)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(corners), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(packed.ravel().astype(np.int32)))
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
        mesh.SetNormalsInterpolation("faceVarying")
        mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(placed))
        mesh.CreateSubdivisionSchemeAttr("none")
        self._paint(mesh, parts)
        return mesh

    def _paint(self, mesh: UsdGeom.Mesh, parts: Sequence[Surface]) -> None:
        """Texture coordinates, colours and materials."""
        from pxr import Sdf, UsdGeom, UsdShade, Vt

        primvars = UsdGeom.PrimvarsAPI(mesh)
        if any(part.uv is not None for part in parts):
            st = primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
            st.Set(Vt.Vec2fArray.FromNumpy(np.concatenate([_coordinates(part) for part in parts])))
        if any(part.colours is not None for part in parts):
            tint = np.concatenate([_tint(part) for part in parts])
            mesh.CreateDisplayColorPrimvar("faceVarying").Set(Vt.Vec3fArray.FromNumpy(tint))
        binding = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
        if len(parts) == 1:
            binding.Bind(self._material(parts[0]))
            return
        first, names = 0, set()
        for part in parts:
            material, name = self._material(part), unused(identifier(part.name), names)
            faces = np.arange(first, first + len(part.faces), dtype=np.int32)
            subset = binding.CreateMaterialBindSubset(name, Vt.IntArray.FromNumpy(faces))
            UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
            first += len(part.faces)
        binding.SetMaterialBindSubsetsFamilyType("partition")

    def _material(self, part: Surface) -> UsdShade.Material:
        """One for each finish of each look."""
        from pxr import Gf, Sdf, UsdShade

        texture = part.finish.texture if part.uv is not None else None
        key = (part.look, part.name, part.base, texture, part.colours is not None)
        if key in self._materials:
            return self._materials[key]
        name = unused(identifier(part.name), {m.GetPrim().GetName() for m in self._materials.values()})
        material = UsdShade.Material.Define(self._stage, f"{self._scope}/{name}")
        shader = UsdShade.Shader.Define(self._stage, f"{self._scope}/{name}/surface")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(ROUGHNESS[part.look])
        shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(METALLIC.get(part.look, 0.0))
        colour = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
        if texture is not None:
            colour.ConnectToSource(self._texture(f"{self._scope}/{name}", texture))
        elif part.colours is not None:
            reader = self._reader(f"{self._scope}/{name}/colours", "float3", "displayColor")
            colour.ConnectToSource(reader)
        else:
            colour.Set(Gf.Vec3f(*linear(np.array(part.base) / 255).tolist()))
        material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
        self._materials[key] = material
        return material

    def _texture(self, path: str, picture: bytes) -> UsdShade.Output:
        """A picture that repeats, looked up by `st`."""
        from pxr import Sdf, UsdShade

        name = self._pictures.setdefault(picture, picture_name(len(self._pictures), picture))
        shader = UsdShade.Shader.Define(self._stage, f"{path}/texture")
        shader.CreateIdAttr("UsdUVTexture")
        shader.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(f"./{self._folder}/{name}"))
        shader.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
        for side in ("wrapS", "wrapT"):
            shader.CreateInput(side, Sdf.ValueTypeNames.Token).Set("repeat")
        coordinates = self._reader(f"{path}/coordinates", "float2", "st")
        shader.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(coordinates)
        return shader.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)

    def _reader(self, path: str, kind: str, primvar: str) -> UsdShade.Output:
        """What a mesh says at each corner."""
        from pxr import Sdf, UsdShade

        shader = UsdShade.Shader.Define(self._stage, path)
        shader.CreateIdAttr(f"UsdPrimvarReader_{kind}")
        shader.CreateInput("varname", Sdf.ValueTypeNames.String).Set(primvar)
        return shader.CreateOutput("result", getattr(Sdf.ValueTypeNames, kind.capitalize()))


def _coordinates(part: Surface) -> Floats32:
    """Texture coordinates of the corners of a surface, zero where it has none, shape (3m, 2)."""
    if part.uv is None:
        return np.zeros((part.faces.size, 2), np.float32)
    return np.ascontiguousarray(part.uv[part.faces.ravel()])


def _tint(part: Surface) -> Floats32:
    """Linear light of the corners of a surface, without its texture, shape (3m, 3)."""
    tint = np.tile(linear(np.array(part.base) / 255), (part.faces.size, 1))
    if part.colours is not None:
        tint *= linear(part.colours[part.faces.ravel(), :3] / 255)
    return tint.astype(np.float32)
