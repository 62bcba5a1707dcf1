"""Run by Blender's Python: where the vertices of every fragment of a file are, frame by frame.

python blender_vertices.py FILE OUT.npz RATE FRAME FRAME ...
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np

READERS = {
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usdz": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".abc": lambda path: bpy.ops.wm.alembic_import(filepath=path),
    ".fbx": lambda path: bpy.ops.import_scene.fbx(filepath=path, anim_offset=0.0),
    ".blend": lambda path: bpy.ops.wm.open_mainfile(filepath=path),
}


def main(file: str, out: str, rate: str, *frames: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = int(rate)
    READERS[Path(file).suffix](file)
    found: dict[str, list[np.ndarray]] = {}
    for frame in map(int, frames):
        bpy.context.scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        for thing in bpy.data.objects:
            if thing.type == "MESH" and thing.name.startswith("fragment_"):
                found.setdefault(thing.name.removesuffix("_mesh"), []).append(vertices(thing.evaluated_get(graph)))
    np.savez(out, **{name: np.stack(each) for name, each in found.items()})


def vertices(thing: bpy.types.Object) -> np.ndarray:
    """In the world, shape (n, 3)."""
    mesh = thing.to_mesh()
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    thing.to_mesh_clear()
    matrix = np.array(thing.matrix_world, float)
    return flat.reshape(-1, 3).astype(float) @ matrix[:3, :3].T + matrix[:3, 3]


if __name__ == "__main__":
    main(*sys.argv[1:])
