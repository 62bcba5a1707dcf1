# SPDX-License-Identifier: MIT
"""Breaks the active object where an arrow points, with the deepfracture program."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from mathutils import Vector

from . import glb, job
from .build import build

# As `deepfracture shatter --help` names them.
BREAKERS = [
    ("physical", "Physical", "Simulate the cracks: any shape, from seconds to a minute or two"),
    ("voronoi", "Voronoi", "Cells around the hit: any shape, at once"),
    ("learned", "Learned", "A model that was trained for this shape: choose its file"),
]
MATERIALS = [
    (name, name.capitalize(), "") for name in ("plaster", "ceramic", "porcelain", "glass", "stone", "concrete")
]


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    program: StringProperty(
        name="Program",
        description="The deepfracture program, as `pip install deepfracture` makes it",
        subtype="FILE_PATH",
        default="deepfracture",
    )

    def draw(self, context):
        self.layout.prop(self, "program")


class Settings(bpy.types.PropertyGroup):
    arrow: PointerProperty(
        name="Arrow",
        description="An empty: the ball comes along its z and breaks what that first meets",
        type=bpy.types.Object,
        poll=lambda self, thing: thing.type == "EMPTY",
    )
    breaker: EnumProperty(name="Breaker", items=BREAKERS, default="physical")
    model: StringProperty(name="Model", description="model.safetensors of a trained shape", subtype="FILE_PATH")
    material: EnumProperty(name="Material", items=MATERIALS, default="plaster")
    inner: PointerProperty(
        name="Inside", description="Material of the crack surfaces; empty: one is made", type=bpy.types.Material
    )
    speed: FloatProperty(name="Speed", description="Of the ball", default=9.0, min=0.01, max=200.0, unit="VELOCITY")
    radius: FloatProperty(name="Ball Radius", default=0.2, min=1e-4, unit="LENGTH")
    seed: IntProperty(name="Seed", description="The same seed breaks the same way", min=0)
    resolution: EnumProperty(
        name="Resolution", items=[(r, r, f"{r} voxels along each axis") for r in ("32", "64", "128")], default="64"
    )
    repair: BoolProperty(name="Repair", description="Mend a mesh that is not closed")
    frame: IntProperty(name="Break at Frame", default=10)
    seconds: FloatProperty(name="Seconds", description="Longest time simulated", default=4.0, min=0.1, max=60.0)
    release: IntProperty(
        name="Release after",
        description="Frames after the break at which Blender's own rigid bodies take over; 0: never, the keys play",
        min=0,
    )
    floor: EnumProperty(
        name="Floor",
        items=[
            ("UNDER", "Under the object", ""),
            ("HEIGHT", "At a height", ""),
            ("NONE", "None", ""),
        ],
    )
    height: FloatProperty(name="Height", unit="LENGTH")


class DEEPFRACTURE_OT_place_arrow(bpy.types.Operator):
    """Place an arrow that points at the active object from the side of the view"""

    bl_idname = "deepfracture.place_arrow"
    bl_label = "Place Arrow"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT" and context.object is not None and context.object.type == "MESH"

    def execute(self, context):
        thing = context.object
        corners = [thing.matrix_world @ Vector(corner) for corner in thing.bound_box]
        middle = sum(corners, Vector()) / 8
        reach = max((corner - middle).length for corner in corners)
        view = getattr(context.space_data, "region_3d", None)
        back = view.view_rotation @ Vector((0, 0, 1)) if view else Vector((0, -1, 0.2)).normalized()
        arrow = bpy.data.objects.new(f"{thing.name} impact", None)
        arrow.empty_display_type, arrow.empty_display_size = "SINGLE_ARROW", 0.6 * reach
        arrow.location = middle + 1.5 * reach * back
        arrow.rotation_mode = "QUATERNION"
        arrow.rotation_quaternion = (-back).to_track_quat("Z", "Y")
        context.collection.objects.link(arrow)
        context.scene.deepfracture.arrow = arrow
        return {"FINISHED"}


class DEEPFRACTURE_OT_break(bpy.types.Operator):
    """Break the active object where the arrow points"""

    bl_idname = "deepfracture.break_object"
    bl_label = "Break"
    bl_options: ClassVar = {"UNDO"}

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT" and context.object is not None and context.object.type == "MESH"

    def execute(self, context):
        """Wait for the program; for scripts."""
        try:
            self.begin(context)
            self.process.wait()
            return self.end(context)
        except job.Refused as problem:
            return self.refuse(problem)
        finally:
            self.clear()

    def invoke(self, context, event):
        """Let the program run while Blender stays alive; Esc stops it."""
        try:
            self.begin(context)
        except job.Refused as problem:
            self.clear()
            return self.refuse(problem)
        self.timer = context.window_manager.event_timer_add(0.2, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set("deepfracture: breaking ... Esc stops it")
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self.process.kill()
            self.process.wait()
            return self.leave(context, {"CANCELLED"})
        if event.type != "TIMER" or self.process.poll() is None:
            return {"PASS_THROUGH"}
        try:
            return self.leave(context, self.end(context))
        except job.Refused as problem:
            return self.leave(context, self.refuse(problem))

    def begin(self, context):
        self.folder = Path(tempfile.mkdtemp(prefix="deepfracture-"))
        self.thing = context.object
        program = context.preferences.addons[__package__].preferences.program
        self.job = job.prepare(context, self.thing, context.scene.deepfracture, program, self.folder)
        self.process = job.start(self.job)

    def end(self, context):
        job.check(self.job, self.process.returncode)
        animation = glb.read(self.job.animation)
        if not any(body.kind == "fragment" for body in animation.bodies):
            raise job.Refused(f"{self.thing.name} did not break: try a faster or larger ball, or another material")
        made = build(context, self.thing, context.scene.deepfracture, animation, self.job.size)
        self.report({"INFO"}, f"{self.thing.name}: {len(made)} fragments")
        return {"FINISHED"}

    def leave(self, context, result):
        context.window_manager.event_timer_remove(self.timer)
        context.workspace.status_text_set(None)
        self.clear()
        return result

    def refuse(self, problem):
        self.report({"ERROR"}, str(problem))
        return {"CANCELLED"}

    def clear(self):
        shutil.rmtree(self.folder, ignore_errors=True)


class DEEPFRACTURE_PT_panel(bpy.types.Panel):
    bl_label = "deepfracture"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "deepfracture"

    def draw(self, context):
        layout, settings = self.layout, context.scene.deepfracture
        layout.use_property_split = True
        row = layout.row(align=True)
        row.prop(settings, "arrow")
        row.operator(DEEPFRACTURE_OT_place_arrow.bl_idname, text="", icon="EMPTY_SINGLE_ARROW")
        column = layout.column()
        column.prop(settings, "breaker")
        if settings.breaker == "learned":
            column.prop(settings, "model")
        else:
            column.prop(settings, "resolution")
        for name in ("material", "inner", "speed", "radius", "seed", "repair"):
            column.prop(settings, name)
        column = layout.column()
        for name in ("frame", "seconds", "release", "floor"):
            column.prop(settings, name)
        if settings.floor == "HEIGHT":
            column.prop(settings, "height")
        layout.operator(DEEPFRACTURE_OT_break.bl_idname, icon="MOD_EXPLODE")


CLASSES = (Preferences, Settings, DEEPFRACTURE_OT_place_arrow, DEEPFRACTURE_OT_break, DEEPFRACTURE_PT_panel)


def register():
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.deepfracture = PointerProperty(type=Settings)


def unregister():
    del bpy.types.Scene.deepfracture
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
