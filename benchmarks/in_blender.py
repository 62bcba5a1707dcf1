"""Programs for Blender's Python: what it sees in our files, and pictures by Cycles.

python in_blender.py vertices FILE OUT.npz RATE FRAME FRAME ...
python in_blender.py picture FILE OUT.png RATE FRAME [SAMPLES]
python in_blender.py addon_picture ADDON.zip PROGRAM OUT.png [BREAKER]
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

# Before bpy is imported: the add-on is installed into a configuration of its own.
os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp()

import bpy
import numpy as np
from mathutils import Vector

LATER = 5
"""Frames from the break to the picture, at 24 per second."""
READERS = {
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usdz": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".abc": lambda path: bpy.ops.wm.alembic_import(filepath=path),
    ".fbx": lambda path: bpy.ops.import_scene.fbx(filepath=path, anim_offset=0.0),
    ".blend": lambda path: bpy.ops.wm.open_mainfile(filepath=path),
}


def vertices(file: str, out: str, rate: str, *frames: str) -> None:
    """Positions of the vertices of every fragment, shape (frames, n, 3) each, as .npz."""
    _open(file, rate)
    found: dict[str, list[np.ndarray]] = {}
    for frame in map(int, frames):
        bpy.context.scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        for thing in bpy.data.objects:
            if thing.type == "MESH" and thing.name.startswith("fragment_"):
                name = thing.name.removesuffix("_mesh")
                found.setdefault(name, []).append(_world_vertices(thing.evaluated_get(graph)))
    np.savez(out, **{name: np.stack(each) for name, each in found.items()})


def picture(file: str, out: str, rate: str, frame: str, samples: str = "24") -> None:
    """The file as Blender opens it, with its own materials."""
    _open(file, rate)
    bpy.context.scene.frame_set(int(frame))
    _render(out, int(samples))


def addon_picture(archive: str, program: str, out: str, breaker: str = "physical") -> None:
    """A ring with a checkered glaze, broken by the add-on."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(
        filepath=os.path.abspath(archive), repo="user_default", enable_on_install=True
    )
    bpy.context.preferences.addons["bl_ext.user_default.deepfracture"].preferences.program = program
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_torus_add(
        major_radius=0.5, minor_radius=0.22, major_segments=96, minor_segments=40, location=(0, 0, 0.72)
    )
    ring = bpy.context.object
    ring.rotation_euler = (1.4, 0, 0.5)
    bpy.ops.object.shade_smooth()
    ring.data.materials.append(_checkered())
    bpy.context.view_layer.update()
    settings = scene.deepfracture
    settings.breaker, settings.radius, settings.speed, settings.frame = breaker, 0.12, 12.0, 10
    bpy.ops.deepfracture.place_arrow()
    settings.arrow.location.z += 0.5
    bpy.context.view_layer.update()
    bpy.ops.deepfracture.break_object()
    bpy.ops.mesh.primitive_plane_add(
        size=40, location=(0, 0, min((ring.matrix_world @ v.co).z for v in ring.data.vertices))
    )
    bpy.context.object.name = "floor in view"
    scene.frame_set(settings.frame + LATER)
    _render(out, 24)


def _open(file: str, rate: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = int(rate)
    READERS[Path(file).suffix](file)


def _world_vertices(thing: bpy.types.Object) -> np.ndarray:
    """In the world, shape (n, 3)."""
    mesh = thing.to_mesh()
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    thing.to_mesh_clear()
    matrix = np.array(thing.matrix_world, float)
    return flat.reshape(-1, 3).astype(float) @ matrix[:3, :3].T + matrix[:3, 3]


def _render(out: str, samples: int) -> None:
    """A small picture by Cycles on the CPU."""
    _add_camera()
    _add_light()
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", samples, True
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.resolution_x, scene.render.resolution_y = 800, 500
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(Path(out).resolve())
    bpy.ops.render.render(write_still=True)


def _add_camera() -> None:
    """A camera that sees every visible mesh but the floor."""
    bpy.context.view_layer.update()
    corners = [
        thing.matrix_world @ Vector(corner)
        for thing in bpy.data.objects
        if thing.type == "MESH" and not thing.hide_render and not thing.name.startswith("floor")
        if min(thing.matrix_world.to_scale()) > 0.1
        for corner in thing.bound_box
    ]
    low = Vector(min(corner[k] for corner in corners) for k in range(3))
    high = Vector(max(corner[k] for corner in corners) for k in range(3))
    middle, size = (low + high) / 2, (high - low).length
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = middle + Vector((-0.55, -1.0, 0.45)).normalized() * 1.55 * size
    camera.rotation_euler = (middle - camera.location).to_track_quat("-Z", "Y").to_euler()
    bpy.context.collection.objects.link(camera)
    bpy.context.scene.camera = camera


def _add_light() -> None:
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = 2.0, 0.1
    sun.rotation_euler = (0.7, -0.3, 0.4)
    bpy.context.collection.objects.link(sun)
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.75, 0.8, 0.9, 1)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    bpy.context.scene.world = world


def _checkered() -> bpy.types.Material:
    material = bpy.data.materials.new("Glaze")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    checker, shader = nodes.new("ShaderNodeTexChecker"), nodes["Principled BSDF"]
    uv, mapping = nodes.new("ShaderNodeUVMap"), nodes.new("ShaderNodeMapping")
    mapping.inputs["Scale"].default_value = (32, 14, 1)
    links.new(uv.outputs["UV"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], checker.inputs["Vector"])
    checker.inputs["Scale"].default_value = 1.0
    checker.inputs["Color1"].default_value = (0.02, 0.13, 0.30, 1)
    checker.inputs["Color2"].default_value = (0.75, 0.72, 0.62, 1)
    links.new(checker.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = 0.25
    return material


if __name__ == "__main__":
    {"vertices": vertices, "picture": picture, "addon_picture": addon_picture}[sys.argv[1]](*sys.argv[2:])
