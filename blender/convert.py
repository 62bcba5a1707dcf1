"""Alembic, FBX, USD or a .blend of an animation that deepfracture wrote, through Blender.

    blender --background --python blender/convert.py -- animation.glb animation.abc

or, where `pip install bpy` has been done, `python blender/convert.py animation.glb animation.abc`. Blender 4.2 or
later. Every frame of the recording becomes one of the file, at the recording's rate; a body that does not exist yet,
or no longer, has no size.
"""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import bpy


def main(arguments: list[str]) -> None:
    if len(arguments) != 2:
        sys.exit("usage: convert.py animation.glb OUT.abc|.fbx|.usdc|.blend")
    source, target = map(Path, arguments)
    if target.suffix not in WRITERS:
        sys.exit(f"{target}: known are {', '.join(WRITERS)}")
    read(source)
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".{target.stem}-part{target.suffix}")
    WRITERS[target.suffix](str(part.resolve()))
    part.replace(target)


def read(source: Path) -> None:
    """An empty scene with the animation in it, one frame of the scene for each of the recording."""
    rate, frames = timing(source)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    # Before the import, which turns seconds into frames.
    scene.render.fps, scene.render.fps_base = round(rate), round(rate) / rate
    bpy.ops.import_scene.gltf(filepath=str(source.resolve()))
    scene.frame_start, scene.frame_end = 0, frames - 1
    scene.frame_set(0)


def timing(source: Path) -> tuple[float, int]:
    """Frames a second and number of frames, as the file's `extras` have them."""
    data = source.read_bytes()
    if data[:4] != b"glTF":
        sys.exit(f"{source}: not a .glb file")
    length = struct.unpack("<I", data[12:16])[0]
    extras = json.loads(data[20 : 20 + length])["asset"].get("extras", {})
    if not {"frame_rate", "frames"} <= extras.keys():
        sys.exit(f"{source}: not written by deepfracture: its frame rate is not known")
    return float(extras["frame_rate"]), int(extras["frames"])


def _alembic(path: str) -> None:
    scene = bpy.context.scene
    bpy.ops.wm.alembic_export(filepath=path, start=scene.frame_start, end=scene.frame_end, face_sets=True)


def _fbx(path: str) -> None:
    # Without thinning of keys; one for each frame.
    bpy.ops.export_scene.fbx(
        filepath=path, bake_anim_simplify_factor=0.0, bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False,
        path_mode="COPY", embed_textures=True, mesh_smooth_type="OFF",
    )  # fmt: skip


def _usd(path: str) -> None:
    bpy.ops.wm.usd_export(filepath=path, export_animation=True)


def _blend(path: str) -> None:
    bpy.ops.wm.save_as_mainfile(filepath=path)


WRITERS: dict[str, Callable[[str], None]] = {".abc": _alembic, ".fbx": _fbx, ".usdc": _usd, ".blend": _blend}

if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
