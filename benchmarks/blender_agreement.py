"""Table of docs/guide/export.md: does Blender see what was recorded? Every vertex of every fragment, each tenth frame.

A scene is written as .glb and .usdc, and converted to .abc and .fbx by blender/convert.py; Blender's Python reads each
file back and says where the vertices are. Each vertex that Blender has is compared, in the user's units, with the one
of the recording that it stands for: the nearest in the first frame, and the same one ever after. Every recorded vertex
has to be stood for.

Needs a Python that can `import bpy` (pip install bpy==5.0.1, Python 3.11, in an environment of its own), named by
--blender or the environment variable DEEPFRACTURE_BLENDER. With --picture it also renders the .glb as Blender opens it.
"""

from __future__ import annotations

import os
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from harness import DATA, ROOT, shape_named, start, table, write_json, write_text
from scipy.spatial import cKDTree

from deepfracture.export import write_glb, write_usd
from deepfracture.export.names import body_names
from deepfracture.geometry.rotations import quat_between, rotation_matrices
from deepfracture.recording.motion import break_frame, pose, similarity
from deepfracture.types import BadInput, Floats, NoSolution, Recording, Track

FORMATS = ("glb", "usdc", "abc", "fbx")
LIMIT = 1e-4
"""Largest deviation that counts as agreement [units of the user's file]."""
STRIDE = 10
"""Frames from one compared frame to the next."""
HERE = Path(__file__).parent
# Blender's importers turn y-up files to its own z-up.
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@dataclass(frozen=True)
class Agreement:
    """How far what Blender shows is from what was recorded."""

    format: str
    fragments: int
    frames: int
    vertices: int
    deviation: float
    """Largest distance of a vertex from where it was recorded [units of the user's file]."""
    ok: bool


def agreement(recording: Recording, folder: Path, blender: str, formats: tuple[str, ...] = FORMATS) -> list[Agreement]:
    """Write `recording` into `folder` in each format, open it in Blender and compare.

    `blender`: a Python that can import bpy."""
    folder.mkdir(parents=True, exist_ok=True)
    first = break_frame(recording)
    if first is None:
        raise BadInput("recording must have fragments in it, nothing broke")
    frames = list(range(-(-first // STRIDE) * STRIDE, recording.frames, STRIDE))
    write_glb(recording, folder / "animation.glb")
    rows = []
    for kind in formats:
        file = folder / f"animation.{kind}"
        if kind == "usdc":
            write_usd(recording, file)
        elif kind != "glb":
            run(blender, ROOT / "blender" / "convert.py", folder / "animation.glb", file)
        run(blender, HERE / "in_blender.py", "vertices", file, folder / f"{kind}.npz", rate(recording), *frames)
        with np.load(folder / f"{kind}.npz") as seen:
            rows.append(compared(recording, kind, dict(seen), frames))
    return rows


def rate(recording: Recording) -> int:
    return round(1 / recording.frame_time)


def run(blender: str, script: Path, *arguments: object) -> str:
    """What a script says that Blender's Python runs."""
    done = subprocess.run([blender, str(script), *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        raise NoSolution(f"{script.name} ended with {done.returncode}: {(done.stdout + done.stderr).strip()[-600:]}")
    return done.stdout


def compared(recording: Recording, kind: str, seen: dict[str, Floats], frames: list[int]) -> Agreement:
    """`seen`: positions (frames, n, 3) of the vertices of each fragment, by its name."""
    names = body_names(recording)
    tracks = {n: t for n, t in zip(names, recording.tracks, strict=True) if t.kind == "fragment" and len(t.positions)}
    if tracks.keys() != seen.keys():
        raise NoSolution(f"{kind}: Blender has {sorted(seen)}, recorded are {sorted(tracks)}")
    worst = 0.0
    for name, track in tracks.items():
        there = [k for k, frame in enumerate(frames) if track.start <= frame < track.stop]
        expected = [in_blender(recording, track, frames[k]) for k in there]
        used = np.unique(track.mesh.faces)
        _, match = cKDTree(expected[0]).query(seen[name][there[0]])
        if np.setdiff1d(used, match).size and not coincide(expected[0], np.setdiff1d(used, match), match):
            return Agreement(kind, len(seen), len(frames), sum(map(points, seen.values())), np.inf, False)
        for k, where in zip(there, expected, strict=True):
            worst = max(worst, float(np.linalg.norm(seen[name][k] - where[match], axis=1).max()))
    return Agreement(kind, len(seen), len(frames), sum(map(points, seen.values())), worst, worst < LIMIT)


def coincide(places: Floats, missing: np.ndarray, matched: np.ndarray) -> bool:
    """Whether every missing vertex lies where a matched one does, as the two sides of a pinch do."""
    return bool(cKDTree(places[np.unique(matched)]).query(places[missing])[0].max() < LIMIT)


def points(each: Floats) -> int:
    return each.shape[1]


def in_blender(recording: Recording, track: Track, frame: int) -> Floats:
    """Where Blender should have the vertices of a body, shape (n, 3): the user's coordinates, their up turned to z."""
    scale, turn, shift = similarity(recording)
    upright = Z_UP @ rotation_matrices(quat_between(turn[:, 2], np.array([0.0, 1.0, 0.0])))
    matrix = pose(track, frame)
    world = track.mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return (scale * world @ turn.T + shift) @ upright.T


def blender_python(given: str | None) -> str:
    """The Python of --blender, or of DEEPFRACTURE_BLENDER."""
    found = given or os.environ.get("DEEPFRACTURE_BLENDER")
    if not found:
        raise BadInput("--blender or DEEPFRACTURE_BLENDER must name a Python that can import bpy (pip install bpy)")
    return found


def broken(name: str, data: Path) -> Recording:
    """A ball thrown at the shape; Voronoi cells, so that any mesh will do."""
    from deepfracture.breakers import make_breaker
    from deepfracture.fracture import material
    from deepfracture.world import simulate, throw_scene

    shape = shape_named(name, data)
    if shape is None:
        raise BadInput(f"{name}: no such shape")
    plaster = material("plaster")
    quat = (0.5**0.5, 0.5**0.5, 0.0, 0.0) if (data / f"{name}.obj").is_file() else (1.0, 0.0, 0.0, 0.0)
    scene = throw_scene(
        name, shape, np.random.default_rng(1), material="plaster", speed=9.0, direction=np.array([0.3, 1.0, -0.15]),
        quat_wxyz=quat,
    )  # fmt: skip
    breaker = make_breaker("voronoi", shape, plaster)
    outcome = simulate(scene, [shape], breaker, np.random.default_rng(1), materials={"plaster": plaster})
    return outcome.recording


def blender_agreement(
    out: Path = Path("runs/blender_agreement"),
    *,
    shapes: tuple[str, ...] = ("pot", "spot"),
    data: Path = DATA,
    blender: str | None = None,
    picture: Path | None = None,
    later: int = 24,
) -> None:
    """Compare all formats for some shapes; with --picture, also draw the first as Blender opens it.

    Args:
        out: folder for the files, agreement.md and agreement.json.
        shapes: built-in shapes, upright, or files DATA/NAME.obj, whose y is up.
        data: folder of mesh files.
        blender: a Python that can import bpy.
        picture: PNG of the first shape's .glb.
        later: frames after the break at which the picture is taken.
    """
    python = blender_python(blender)
    rows = []
    for name in shapes:
        recording = broken(name, data)
        rows += [{"shape": name, **asdict(row)} for row in agreement(recording, out / name, python)]
        if picture is not None and name == shapes[0]:
            frame = (break_frame(recording) or 0) + later
            run(
                python, HERE / "in_blender.py", "picture", out / name / "animation.glb", picture, rate(recording), frame
            )
    write_json(out / "agreement.json", rows)
    lines = [[*[*row.values()][:5], f"{row['deviation']:.1e}", "yes" if row["ok"] else "NO"] for row in rows]
    head = ["shape", "format", "fragments", "frames", "vertices", "largest deviation", "within 1e-4"]
    write_text(out / "agreement.md", table(head, lines))


if __name__ == "__main__":
    start(blender_agreement)
