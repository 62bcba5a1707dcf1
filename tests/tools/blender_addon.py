"""Run by Blender's Python: installs the add-on from its zip, breaks an object, and says in JSON what is there.

python blender_addon.py ADDON.zip PROGRAM OUT.json FOLDER
"""

import json
import os
import sys

archive, program, out, folder = map(os.path.abspath, sys.argv[1:])
os.environ["BLENDER_USER_RESOURCES"] = folder
import bpy  # noqa: E402
import numpy as np  # noqa: E402


def table():
    """A slab of odd shape and place, with two materials and texture coordinates of its own name."""
    bpy.ops.mesh.primitive_cube_add(size=1)
    thing = bpy.context.object
    thing.name = "Slab"
    thing.data.uv_layers[0].name = "Atlas"
    for name, colour in (("Clay", (1, 0, 0, 1)), ("Glaze", (0, 0, 1, 1))):
        material = bpy.data.materials.new(name)
        material.diffuse_color = colour
        thing.data.materials.append(material)
    for k, polygon in enumerate(thing.data.polygons):
        polygon.material_index = k % 2
    thing.scale, thing.rotation_euler, thing.location = (0.6, 0.2, 0.4), (0.3, 0.2, 1.0), (3, -2, 1)
    bpy.context.view_layer.update()
    return thing


def corners(thing):
    """World places, texture coordinates and slots of the corners of its faces."""
    mesh, matrix = thing.data, np.array(thing.matrix_world)
    mesh.calc_loop_triangles()
    places = np.array([mesh.vertices[v].co for t in mesh.loop_triangles for v in t.vertices], float)
    uv = np.array([mesh.uv_layers.active.uv[k].vector for t in mesh.loop_triangles for k in t.loops])
    slots = np.array([t.material_index for t in mesh.loop_triangles])
    return places @ matrix[:3, :3].T + matrix[:3, 3], uv, slots


def closed(mesh):
    uses = {}
    for polygon in mesh.polygons:
        for edge in polygon.edge_keys:
            uses[edge] = uses.get(edge, 0) + 1
    return set(uses.values()) == {2}


def volume(places):
    a, b, c = places.reshape(-1, 3, 3).transpose(1, 0, 2)
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def expected_uv(thing, points, slots):
    """What the original has at corners (3m, 3) of triangles on it: by the face that a triangle's middle lies in."""
    mesh, back = thing.data, np.linalg.inv(np.array(thing.matrix_world, float))
    local = points @ back[:3, :3].T + back[:3, 3]
    middles = local.reshape(-1, 3, 3).mean(axis=1)
    found = np.full((len(slots), 3, 2), np.nan)
    for polygon in mesh.polygons:
        frame = np.array([mesh.vertices[v].co for v in polygon.vertices], float)
        uv = np.array([mesh.uv_layers.active.uv[k].vector for k in polygon.loop_indices], float)
        sides, along = np.stack([frame[1] - frame[0], frame[3] - frame[0]]), np.stack([uv[1] - uv[0], uv[3] - uv[0]])
        on = np.abs((middles - frame[0]) @ np.array(polygon.normal)) < 1e-5
        on &= slots == polygon.material_index
        share = (local.reshape(-1, 3, 3)[on] - frame[0]) @ sides.T / (sides**2).sum(axis=1)
        found[on] = uv[0] + share @ along
    return found.reshape(-1, 2)


def at(frame):
    bpy.context.scene.frame_set(frame)
    bpy.context.view_layer.update()


def facts(thing, pieces):
    scene, settings = bpy.context.scene, bpy.context.scene.deepfracture
    at(settings.frame)
    whole, _, _ = corners(thing)
    said = {"whole_volume": volume(whole), "pieces": []}
    for piece in pieces:
        places, uv, slots = corners(piece)
        outside = np.repeat(slots < 2, 3)
        there = expected_uv(thing, places[outside], slots[slots < 2])
        at(settings.frame + 12)
        moved = np.array(piece.matrix_world.translation)
        at(settings.frame)
        said["pieces"].append(
            {
                "volume": volume(places), "closed": closed(piece.data), "faces": len(slots),
                "materials": [m.name for m in piece.data.materials], "slots": sorted(set(slots.tolist())),
                "uv_layer": piece.data.uv_layers.active.name,
                "uv_error": float(np.nanmax(np.abs(there - uv[outside]), initial=0.0)),
                "uv_known": float(np.isfinite(there).mean()) if len(there) else 1.0,
                "moved": float(np.linalg.norm(moved - np.array(piece.matrix_world.translation))),
                "mass": piece.rigid_body.mass, "type": piece.rigid_body.type, "kinematic": piece.rigid_body.kinematic,
                "shape": piece.rigid_body.collision_shape, "hidden": piece.hide_render,
                "keys": keys(piece),
            }
        )  # fmt: skip
    said["whole_hidden"] = thing.hide_render
    at(settings.frame - 1)
    said["before"] = {"whole_hidden": thing.hide_render, "pieces_hidden": [piece.hide_render for piece in pieces]}
    said["frame_end"] = scene.frame_end
    return said


def keys(thing):
    """How many keys each of its channels has."""
    slot, action = thing.animation_data.action_slot, thing.animation_data.action
    bags = [strip.channelbag(slot) for layer in action.layers for strip in layer.strips]
    return {f"{c.data_path} {c.array_index}": len(c.keyframe_points) for bag in bags for c in bag.fcurves}


def broken(thing):
    return [o for o in bpy.data.objects if o.name.startswith(f"{thing.name} fragment")]


def released(settings, thing):
    """Blender's own rigid bodies from the break on: do pieces fall, and lie on the floor?"""
    scene = bpy.context.scene
    pieces = broken(thing)
    scene.rigidbody_world.point_cache.frame_end = 80
    for frame in range(1, 70):
        scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    slab = bpy.data.objects[f"{thing.name} floor"]
    floor = slab.location.z + slab.dimensions.z / 2
    lows = []
    for piece in pieces:
        places = np.array([piece.evaluated_get(graph).matrix_world @ v.co for v in piece.data.vertices])
        lows.append(float(places[:, 2].min() - floor))
    return lows


def main():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
    addon = bpy.context.preferences.addons["bl_ext.user_default.deepfracture"]
    said = {"installed": True}
    thing = table()
    settings = bpy.context.scene.deepfracture
    settings.breaker, settings.resolution, settings.frame, settings.radius = "voronoi", "32", 10, 0.1
    settings.speed, settings.seconds = 15.0, 1.5
    addon.preferences.program = "no-such-program"
    said["without_program"] = attempt()
    addon.preferences.program = program
    said["without_arrow"] = attempt()
    bpy.ops.deepfracture.place_arrow()
    settings.arrow.location.x += 50
    bpy.context.view_layer.update()
    said["past"] = attempt()
    settings.arrow.location.x -= 50
    bpy.context.view_layer.update()
    settings.speed, bpy.context.scene.use_gravity = 0.02, False
    said["soft"] = attempt()
    settings.speed, bpy.context.scene.use_gravity = 15.0, True
    said["objects_before"] = sorted(o.name for o in bpy.data.objects)
    bpy.ops.ed.undo_push(message="before")
    said["result"] = attempt()
    thing = bpy.data.objects["Slab"]
    said["facts"] = facts(thing, broken(thing))
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    said["objects_undone"] = sorted(o.name for o in bpy.data.objects)
    said["hidden_undone"] = bpy.data.objects["Slab"].hide_render
    bpy.context.view_layer.objects.active = bpy.data.objects["Slab"]
    settings = bpy.context.scene.deepfracture
    settings.release = 3
    said["again"] = attempt()
    said["heights"] = released(settings, bpy.data.objects["Slab"])
    with open(out, "w") as file:
        json.dump(said, file, indent=1)


def attempt():
    """What the operator answers, or the line that it refuses with."""
    try:
        return sorted(bpy.ops.deepfracture.break_object())
    except RuntimeError as problem:
        return str(problem).strip()


main()
