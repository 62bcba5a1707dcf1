"""Files that a player can save."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

from deepfracture.export import write_glb
from deepfracture.export.usd import write_usd
from deepfracture.play.library import Entry
from deepfracture.render import write_film
from deepfracture.runtime.files import scratch_folder
from deepfracture.types import BadInput, Recording
from deepfracture.world import Scene, save_scene

FILES = {"glb": "deepfracture.glb", "usd": "deepfracture.usdc", "film": "deepfracture.mp4", "scene": "scene.toml"}
"""File names by kind."""


def make_file(kind: str, recording: Recording, scene: Scene, entry: Entry) -> tuple[str, bytes]:
    """Name and content of a file. BadInput: a library that it needs is not installed."""
    if kind not in FILES:
        raise BadInput(f"kind must be one of {', '.join(FILES)}, got {kind!r}")
    if kind == "scene" and entry.file is not None:
        return "scene.zip", _with_mesh(scene, entry.file, entry.model)
    name = FILES[kind]
    if kind == "usd" and any(track.whole is not None and track.whole.appearance for track in recording.tracks):
        name = "deepfracture.usdz"  # includes the textures
    writers = {
        "glb": lambda path: write_glb(recording, path),
        "usd": lambda path: write_usd(recording, path, gravity=scene.gravity, contact_material=scene.contact_material),
        "film": lambda path: write_film(recording, path),
        "scene": lambda path: save_scene(scene, path),
    }
    with scratch_folder() as folder:
        path = folder / name
        writers[kind](path)
        return name, path.read_bytes()


def _with_mesh(scene: Scene, mesh: Path, model: Path | None) -> bytes:
    """A ZIP archive with the scene file, the mesh, the model and instructions."""
    name = f"mesh{mesh.suffix.lower()}"
    placed = tuple(replace(one, shape=name) for one in scene.shapes)
    command = "deepfracture shatter --scene scene.toml"
    if model is not None:
        command += " --model model.safetensors"
    archive = io.BytesIO()
    with scratch_folder() as folder:
        file = folder / "scene.toml"
        save_scene(replace(scene, shapes=placed), file)
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
            packed.write(file, file.name)
            packed.write(mesh, name)
            if model is not None:
                packed.write(model, "model.safetensors")
            packed.writestr(
                "replay.txt", f"Unpack this archive. To reproduce the simulation, frame by frame:\n\n    {command}\n"
            )
    return archive.getvalue()
