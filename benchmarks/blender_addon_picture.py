"""Run by Blender's Python: a ring with a checkered glaze, broken by the add-on, drawn by Cycles with its own materials.

python blender_addon_picture.py ADDON.zip PROGRAM OUT.png [BREAKER]
"""

from __future__ import annotations

import os
import sys
import tempfile

# Before bpy is there: the add-on goes into a Blender of its own.
os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp()

import bpy
from blender_picture import draw, light, look_at_action

LATER = 5
"""Frames after the break, at 24 a second."""


def main(archive: str, program: str, out: str, breaker: str = "physical") -> None:
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
    ring.data.materials.append(checkered())
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
    bpy.context.object.name = "floor that is seen"
    scene.frame_set(settings.frame + LATER)
    look_at_action()
    light()
    draw(out, 24)


def checkered() -> bpy.types.Material:
    material = bpy.data.materials.new("Glaze")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    checker, shader = nodes.new("ShaderNodeTexChecker"), nodes["Principled BSDF"]
    place, spread = nodes.new("ShaderNodeUVMap"), nodes.new("ShaderNodeMapping")
    spread.inputs["Scale"].default_value = (32, 14, 1)
    links.new(place.outputs["UV"], spread.inputs["Vector"])
    links.new(spread.outputs["Vector"], checker.inputs["Vector"])
    checker.inputs["Scale"].default_value = 1.0
    checker.inputs["Color1"].default_value = (0.02, 0.13, 0.30, 1)
    checker.inputs["Color2"].default_value = (0.75, 0.72, 0.62, 1)
    links.new(checker.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = 0.25
    return material


if __name__ == "__main__":
    main(*sys.argv[1:])
