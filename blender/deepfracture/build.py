# SPDX-License-Identifier: MIT
"""Objects of Blender for what broke: fragments with materials, texture coordinates, keys and rigid bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np

from .glb import Animation, Body

INNER = "deepfracture inner"
FLOOR = 40
"""Half the side of the floor, in radii of the object: what flies far still lands."""


@dataclass(frozen=True)
class Timing:
    """When Blender shows what."""

    first: int
    """The frame in which it breaks."""
    fps: float
    size: float
    """Blender's seconds for each of the program's."""
    broke: float
    """When that was in the program's world [s]: the last moment that it recorded before there were fragments."""

    def frames(self, animation: Animation) -> tuple[np.ndarray, np.ndarray]:
        """Frames from the break to the end, and their times in the program's world [s]."""
        count = int(np.ceil((animation.duration - self.broke) * self.size * self.fps)) + 1
        frames = np.arange(self.first, self.first + count)
        return frames, np.minimum(self.broke + (frames - self.first) / self.fps / self.size, animation.duration)


def build(context, thing, settings, animation: Animation, size: float) -> list[bpy.types.Object]:
    """Put the fragments and the ball in the place of `thing`; returns the fragments."""
    scene = context.scene
    pieces = [body for body in animation.bodies if body.kind == "fragment"]
    broke = min(piece.start for piece in pieces) - animation.step
    timing = Timing(settings.frame, scene.render.fps / scene.render.fps_base, size, broke)
    collection = bpy.data.collections.new(f"{thing.name} fragments")
    scene.collection.children.link(collection)
    materials = _materials(thing, settings)
    layer = thing.data.uv_layers.active.name if thing.type == "MESH" and thing.data.uv_layers.active else "UVMap"
    made = []
    for body in [body for body in animation.bodies if body.kind in ("fragment", "ball")]:
        ball = body.kind == "ball"
        mesh = _mesh(body, f"{thing.name} {body.name}", [] if ball else materials, layer)
        piece = bpy.data.objects.new(mesh.name, mesh)
        collection.objects.link(piece)
        _animate(piece, body, animation, timing)
        _weigh(scene, piece, (body.mass or 1.0) * size**3, "SPHERE" if ball else "CONVEX_HULL", settings)
        if not ball:
            made.append(piece)
    _hide(thing, timing.first, there_before=True)
    frames, _ = timing.frames(animation)
    scene.frame_end = max(scene.frame_end, int(frames[-1]))
    scene.rigidbody_world.point_cache.frame_end = max(scene.frame_end, scene.rigidbody_world.point_cache.frame_end)
    if settings.floor != "NONE":
        _floor(context, thing, settings, collection)
    return made


def _materials(thing, settings) -> list[bpy.types.Material | None]:
    """Those of the object, slot by slot, and one more for the inside."""
    inner = settings.inner or bpy.data.materials.get(INNER)
    if inner is None:
        inner = bpy.data.materials.new(INNER)
        inner.diffuse_color = (0.81, 0.49, 0.30, 1.0)
        inner.use_nodes = True
        shader = next(node for node in inner.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        shader.inputs["Base Color"].default_value = inner.diffuse_color
        shader.inputs["Roughness"].default_value = 0.95
    return [*([slot.material for slot in thing.material_slots] or [None]), inner]


def _mesh(body: Body, name: str, materials: list, layer: str) -> bpy.types.Mesh:
    """One closed mesh: vertices that the file splits along creases and seams are one again."""
    vertices = np.concatenate([part.vertices for part in body.parts])
    places, vertex = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True)
    starts = np.cumsum([0, *(len(part.vertices) for part in body.parts)])
    corners = np.concatenate([part.faces + start for part, start in zip(body.parts, starts, strict=False)]).ravel()
    faces = vertex.reshape(-1)[corners].reshape(-1, 3)
    kept = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    corners, faces = corners.reshape(-1, 3)[kept].ravel(), faces[kept]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(places.tolist(), [], faces.tolist())
    for material in materials:
        mesh.materials.append(material)
    slots = np.concatenate([np.full(len(p.faces), _slot(p.material, len(materials))) for p in body.parts])[kept]
    mesh.polygons.foreach_set("material_index", slots.astype(np.int32))
    uv = np.concatenate([np.zeros((len(p.vertices), 2)) if p.uv is None else p.uv for p in body.parts])
    mesh.uv_layers.new(name=layer).uv.foreach_set("vector", uv[corners].ravel().astype(np.float32))
    normals = np.concatenate([part.normals for part in body.parts])
    mesh.normals_split_custom_set(normals[corners].tolist())
    mesh.update()
    return mesh


def _slot(material: str, count: int) -> int:
    """slot_3 is the fourth; everything that is not the object's is the inside, the last."""
    number = material.removeprefix("slot_")
    return int(number) if number.isdigit() and int(number) < count - 1 else max(count - 1, 0)


def _animate(piece, body: Body, animation: Animation, timing: Timing) -> None:
    """Keys for every frame in which it exists; hidden before and after."""
    frames, times = timing.frames(animation)
    body = _from_rest(body, timing.broke, animation.step)
    there = (times >= body.start - 1e-6) & (times < body.stop)
    frames, times = frames[there], times[there]
    places, turns = body.at(times)
    piece.rotation_mode = "QUATERNION"
    piece.location, piece.rotation_quaternion = places[0], turns[0]
    piece.keyframe_insert("location", frame=frames[0])
    piece.keyframe_insert("rotation_quaternion", frame=frames[0])
    for curve in _curves(piece):
        values = (places if curve.data_path == "location" else turns)[:, curve.array_index]
        curve.keyframe_points.add(len(frames) - 1)
        curve.keyframe_points.foreach_set("co", np.stack([frames, values], axis=1).ravel())
        curve.keyframe_points.foreach_set("interpolation", np.full(len(frames), 1))  # linear
        curve.update()
    if body.kind == "fragment":
        _hide(piece, int(frames[0]), there_before=False)
        if times[-1] < animation.duration - 1e-6:
            _hide(piece, int(frames[-1]) + 1, there_before=True)


def _from_rest(body: Body, broke: float, step: float) -> Body:
    """A fragment of the object begins where it is in it: as long as the whole is shown, it does not move."""
    if body.kind != "fragment" or body.rest is None or body.start > broke + 1.5 * step:
        return body
    (when, places), (since, turns) = body.moves, body.turns
    upright = np.array([[1.0, 0, 0, 0]]) * (1 if turns[0, 0] >= 0 else -1)
    return replace(
        body,
        start=broke,
        moves=(np.concatenate([[broke], when]), np.concatenate([body.rest[None], places])),
        turns=(np.concatenate([[broke], since]), np.concatenate([upright, turns])),
    )


def _curves(thing) -> list:
    """The curves of its action; since Blender 5 they lie in layers."""
    action = thing.animation_data.action
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    slot = thing.animation_data.action_slot
    return [curve for layer in action.layers for strip in layer.strips for curve in strip.channelbag(slot).fcurves]


def _hide(thing, frame: int, *, there_before: bool) -> None:
    """Seen before a frame and not from it on, or the other way round."""
    for when, hidden in ((frame - 1, not there_before), (frame, there_before)):
        thing.hide_viewport = thing.hide_render = hidden
        thing.keyframe_insert("hide_viewport", frame=when)
        thing.keyframe_insert("hide_render", frame=when)


def _weigh(scene, piece, mass: float, shape: str, settings) -> None:
    """A rigid body that follows its keys, and from a frame on is free, if that is wished."""
    _world(scene).collection.objects.link(piece)
    body = piece.rigid_body
    body.type, body.mass, body.collision_shape = "ACTIVE", mass, shape
    body.friction, body.restitution = 0.5, 0.2
    body.use_margin, body.collision_margin = True, 0.0
    body.kinematic = True
    if settings.release > 0:
        for when, held in ((settings.frame, True), (settings.frame + settings.release, False)):
            body.kinematic = held
            piece.keyframe_insert("rigid_body.kinematic", frame=when)


def _world(scene):
    if scene.rigidbody_world is None:
        bpy.ops.rigidbody.world_add()
    world = scene.rigidbody_world
    if world.collection is None:
        world.collection = bpy.data.collections.new("RigidBodyWorld")
    return world


def _floor(context, thing, settings, collection) -> None:
    """A slab that fragments lie on once they are free; it is not rendered."""
    corners = [thing.matrix_world @ vertex.co for vertex in thing.data.vertices]
    height = min(c.z for c in corners) if settings.floor == "UNDER" else settings.height
    middle = sum(corners, corners[0] * 0) / len(corners)
    radius = max((corner - middle).length for corner in corners)
    reach, half = FLOOR * radius, radius / 2
    # About its origin, as Blender takes boxes to be.
    x, y, z = np.meshgrid((-reach, reach), (-reach, reach), (-half, half), indexing="ij")
    box = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new(f"{thing.name} floor")
    mesh.from_pydata(box.tolist(), [], sides)
    slab = bpy.data.objects.new(mesh.name, mesh)
    slab.location = (middle.x, middle.y, height - half)
    slab.hide_render, slab.display_type = True, "BOUNDS"
    collection.objects.link(slab)
    _world(context.scene).collection.objects.link(slab)
    slab.rigid_body.type, slab.rigid_body.collision_shape, slab.rigid_body.friction = "PASSIVE", "BOX", 0.6
