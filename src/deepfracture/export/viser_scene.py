"""Bodies in a scene of viser's."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.export.gltf import surface_glb
from deepfracture.recording.surface import COLOURS, Surface

if TYPE_CHECKING:
    from viser import SceneApi

FLOOR_WIDTH = 200.0
"""Side of the drawn floor [m]."""
TEXTURE_SIDE = 512
"""Texels along the longer side of a texture at most."""


def add_floor(scene: SceneApi, height: float) -> None:
    """A wide floor that shows shadows, at a height [m]."""
    corner = FLOOR_WIDTH / 2
    scene.add_mesh_simple(
        "/floor",
        np.array([[-corner, -corner, 0], [corner, -corner, 0], [corner, corner, 0], [-corner, corner, 0]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
        color=COLOURS["floor"],
        position=(0.0, 0.0, height),
        cast_shadow=False,
        receive_shadow=0.3,
    )


def add_surface(scene: SceneApi, surface: Surface, name: str) -> None:
    """One surface; with a texture or colours of its own it travels as glTF."""
    if surface.colours is None and (surface.uv is None or surface.finish.texture is None):
        scene.add_mesh_simple(name, surface.vertices, surface.faces, color=surface.base)
        return
    if surface.finish.texture is not None:
        surface = replace(surface, finish=replace(surface.finish, texture=_small(surface.finish.texture)))
    scene.add_glb(name, surface_glb(surface))


@lru_cache(maxsize=8)
def _small(texture: bytes) -> bytes:
    """A texture as a JPEG that is small enough to travel with every fragment."""
    from PIL import Image

    with Image.open(io.BytesIO(texture)) as picture:
        picture.thumbnail((TEXTURE_SIDE, TEXTURE_SIDE))
        small = io.BytesIO()
        picture.convert("RGB").save(small, format="JPEG", quality=85)
    return small.getvalue()
