"""Run by Blender's Python: a picture of a file as Blender opens it, with its own materials, drawn by Cycles.

python blender_picture.py FILE OUT.png RATE FRAME [SAMPLES]
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from blender_vertices import READERS
from mathutils import Vector


def main(file: str, out: str, rate: str, frame: str, samples: str = "24") -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = int(rate)
    READERS[Path(file).suffix](file)
    scene.frame_set(int(frame))
    look_at_action()
    light()
    draw(out, int(samples))


def draw(out: str, samples: int) -> None:
    """Cycles on the processor, small."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", samples, True
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.resolution_x, scene.render.resolution_y = 800, 500
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(Path(out).resolve())
    bpy.ops.render.render(write_still=True)


def look_at_action() -> None:
    """A camera that has in view whatever is no floor and there."""
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


def light() -> None:
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = 2.0, 0.1
    sun.rotation_euler = (0.7, -0.3, 0.4)
    bpy.context.collection.objects.link(sun)
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.75, 0.8, 0.9, 1)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    bpy.context.scene.world = world


if __name__ == "__main__":
    main(*sys.argv[1:])
