# SPDX-License-Identifier: MIT
"""What the program is asked to do: the object and a scene, in files of a folder of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

STEEL = 7800.0
"""Density of the ball [kg/m^3]."""
RECORDED, STEPS = 60, 4
"""The program's frames a second, at least, and steps for each."""


class Refused(Exception):
    """What the person has to change, in one line."""


@dataclass(frozen=True)
class Job:
    """A command that is ready to run."""

    command: list[str]
    folder: Path
    size: float
    """Blender's units per metre of the program's world, where the object is two metres long. Seconds of Blender per
    second of that world, too: so a ball's speed, and with it the stress, is the same in both, and so is the ratio of
    gravity to what is thrown."""

    @property
    def animation(self) -> Path:
        return self.folder / "out" / "animation.glb"


def prepare(context: bpy.types.Context, thing: bpy.types.Object, settings, program: str, folder: Path) -> Job:
    """Write object.obj and scene.json into `folder`. Refused says what is wrong."""
    found = shutil.which(bpy.path.abspath(program))
    if found is None:
        raise Refused(f"{program!r} was not found: name the deepfracture program in the add-on's preferences")
    if settings.arrow is None:
        raise Refused("there is no arrow: press Place Arrow, or choose an empty that points at the object")
    places, tree = _surface(context, thing)
    low, high = places.min(axis=0), places.max(axis=0)
    size, centre = float((high - low).max()) / 2, (low + high) / 2
    write_obj(context, thing, folder / "object.obj")
    (folder / "scene.json").write_text(json.dumps(_scene(context, settings, tree, low, size, centre)))
    command = [os.path.abspath(found), "shatter", "--scene", str(folder / "scene.json"), "--breaker", settings.breaker]
    command += ["--resolution", settings.resolution, "--formats", "glb", "--out", str(folder / "out")]
    command += ["--repair"] if settings.repair else []
    if settings.breaker == "learned" and settings.model:
        command += ["--model", bpy.path.abspath(settings.model)]
    return Job(command, folder, size)


def start(job: Job) -> subprocess.Popen:
    """Run the program; what it says goes into a file of the folder."""
    try:
        with (job.folder / "said.txt").open("w") as said:
            return subprocess.Popen(job.command, stdout=said, stderr=said, cwd=job.folder)
    except OSError as problem:
        raise Refused(f"{job.command[0]} does not start: {problem.strerror}") from problem


def check(job: Job, status: int) -> None:
    """Raise Refused with the program's own last line if it did not end well."""
    if status or not job.animation.is_file():
        lines = (job.folder / "said.txt").read_text().strip().splitlines() or ["the program said nothing"]
        raise Refused(lines[-1].removeprefix("deepfracture: "))


def write_obj(context: bpy.types.Context, thing: bpy.types.Object, path: Path) -> None:
    """The object with its modifiers, in the world's coordinates: triangles, active UVs, normals, a material a slot."""
    graph = context.evaluated_depsgraph_get()
    own = thing.evaluated_get(graph)
    mesh = own.to_mesh()
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    corners, loops, slots = np.empty(3 * count, int), np.empty(3 * count, int), np.empty(count, int)
    mesh.loop_triangles.foreach_get("vertices", corners)
    mesh.loop_triangles.foreach_get("loops", loops)
    mesh.loop_triangles.foreach_get("material_index", slots)
    places, normals = np.empty(3 * len(mesh.vertices)), np.empty(3 * len(mesh.loops))
    mesh.vertices.foreach_get("co", places)
    mesh.corner_normals.foreach_get("vector", normals)
    matrix = np.array(thing.matrix_world)
    places = places.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    normals = normals.reshape(-1, 3) @ np.linalg.inv(matrix[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    layer = mesh.uv_layers.active
    uv = np.zeros(0)
    if layer is not None:
        uv = np.empty(2 * len(mesh.loops))
        layer.uv.foreach_get("vector", uv)
    own.to_mesh_clear()
    corners, loops = corners.reshape(-1, 3), loops.reshape(-1, 3)
    if np.linalg.det(matrix[:3, :3]) < 0:  # mirrored
        corners, loops = corners[:, ::-1], loops[:, ::-1]
    lines = ["mtllib object.mtl", *_rows("v", places), *_rows("vt", uv.reshape(-1, 2)), *_rows("vn", normals)]
    for slot in np.unique(slots):
        lines.append(f"usemtl slot_{slot}")
        for face, corner in zip(
            (corners[slots == slot] + 1).tolist(), (loops[slots == slot] + 1).tolist(), strict=True
        ):
            lines.append("f " + " ".join(f"{v}/{n if len(uv) else ''}/{n}" for v, n in zip(face, corner, strict=True)))
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".mtl").write_text("".join(f"newmtl slot_{k}\nKd 0.8 0.8 0.8\n" for k in np.unique(slots)))


def _rows(key: str, values: np.ndarray) -> list[str]:
    return [f"{key} " + " ".join(f"{value:.9g}" for value in row) for row in values.tolist()]


def _surface(context: bpy.types.Context, thing: bpy.types.Object) -> tuple[np.ndarray, BVHTree]:
    """Vertices in the world, and a tree to shoot at."""
    own = thing.evaluated_get(context.evaluated_depsgraph_get())
    mesh = own.to_mesh()
    mesh.calc_loop_triangles()
    faces = np.array([triangle.vertices for triangle in mesh.loop_triangles], int).reshape(-1, 3)
    places = np.array([thing.matrix_world @ vertex.co for vertex in mesh.vertices], float).reshape(-1, 3)
    own.to_mesh_clear()
    if not len(faces):
        raise Refused(f"{thing.name} has no faces")
    return places, BVHTree.FromPolygons(places.tolist(), faces.tolist())


def _scene(
    context: bpy.types.Context, settings, tree: BVHTree, low: np.ndarray, size: float, centre: np.ndarray
) -> dict:
    """The program's scene: lengths are divided by `size`, times too, so speeds are what they are."""
    aim = settings.arrow.matrix_world.to_quaternion() @ Vector((0, 0, 1))
    tip = settings.arrow.matrix_world.translation
    far = tip - aim * (20 * size + (Vector(centre) - tip).length)
    place, *_ = tree.ray_cast(far, aim)
    if place is None:
        raise Refused("the arrow points past the object: it breaks where the line of the arrow's z first meets it")
    # Just before it touches, so that nothing falls before it is hit.
    ball = place - aim * (settings.radius + 0.02 * size)
    fps = context.scene.render.fps / context.scene.render.fps_base
    rate = RECORDED * max(1, int(np.ceil(fps * size / RECORDED)))
    gravity = max(0.0, -context.scene.gravity.z) if context.scene.use_gravity else 0.0
    scene = {
        "shapes": [{"shape": "object.obj", "material": settings.material}],
        "balls": [
            {
                "radius": settings.radius / size,
                "density": STEEL,
                "position": ((np.array(ball) - centre) / size).tolist(),
                "velocity": (np.array(aim) * settings.speed).tolist(),
            }
        ],
        "gravity": gravity * size,
        "duration": settings.seconds / size,
        "frame_rate": rate,
        "steps_per_second": STEPS * rate,
        "seed": settings.seed,
    }
    if settings.floor != "NONE":
        height = low[2] if settings.floor == "UNDER" else settings.height
        scene["floor"] = {"height": float(height - centre[2]) / size - 1e-3}
    return scene
