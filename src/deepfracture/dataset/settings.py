"""What a data set simulates: the manifest and the mesh beside it."""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from deepfracture.dataset.arrays import (
    MESH_ARRAYS,
    PATTERN_ARRAYS,
    array_header,
    decode_mesh_array,
    encode_mesh,
    group_headers,
    mesh_key,
)
from deepfracture.dataset.record import MAX_JSON_BYTES, RECORD_FOLDER, parse_json
from deepfracture.dataset.storage import Storage, open_storage
from deepfracture.runtime.extras import is_installed, require
from deepfracture.types import BadInput, Grid, Material, Mesh, Shape

MIN_PYTHON = (3, 11)
"""Oldest Python for which there is zarr 3."""
FORMAT = 3
"""Version of the format, in the manifest."""
MANIFEST = "dataset.json"
TOP_LEVEL = {MANIFEST, "zarr.json", "shape", "labels", "distance", RECORD_FOLDER}
"""Names directly in the folder of a data set."""
MAX_MESH = 20_000_000
"""Most vertices or faces of a mesh that is read."""


@dataclass(frozen=True, eq=False)
class DatasetSettings:
    """Everything that determines collision k of a data set."""

    shape: Shape
    material: Material
    resolution: int
    seed: int
    speed_range: tuple[float, float]
    """Slowest and fastest ball [m/s]."""
    scene: str = "single"
    """Kind of scene, one of `world.KINDS`."""
    refracture: int = 0
    """Generations of fragments that may break again."""
    frames: int = 0
    """Frames after the hit in which they may, at 60 a second."""
    repeats: int = 1
    """Simulations of each collision, with different realisations of the material's strength."""

    def manifest(self) -> dict[str, Any]:
        """The content of `dataset.json`."""
        mesh = self.shape.mesh
        return {
            "format": FORMAT,
            "shape": {
                "name": self.shape.name,
                "scale": self.shape.scale,
                "centre": self.shape.centre.tolist(),
                "vertices": len(mesh.vertices),
                "faces": len(mesh.faces),
                "sha256": mesh_digest(mesh),
            },
            "material": asdict(self.material),
            "resolution": self.resolution,
            "seed": self.seed,
            "speed_range": list(self.speed_range),
            "scene": self.scene,
            "refracture": self.refracture,
            "frames": self.frames,
            "repeats": self.repeats,
        }

    @staticmethod
    def from_manifest(manifest: dict[str, Any], mesh: Mesh) -> DatasetSettings:
        """The settings in a manifest.

        Raises:
            ValueError, KeyError, TypeError: A value is missing or senseless."""
        shape = manifest["shape"]
        slow, fast = manifest["speed_range"]
        return DatasetSettings(
            Shape(str(shape["name"]), mesh, float(shape["scale"]), shape["centre"]),
            Material(**manifest["material"]),
            Grid(manifest["resolution"]).resolution,
            int(manifest["seed"]),
            (float(slow), float(fast)),
            str(manifest["scene"]),
            *(int(manifest[name]) for name in ("refracture", "frames", "repeats")),
        )


def dataset_storage(location: Path | str | Storage) -> Storage:
    """The storage of a data set; every data set is opened here, after a check that zarr is installed.

    Raises:
        BadInput: zarr or obstore is not installed, or the address is no folder or bucket."""
    if sys.version_info < MIN_PYTHON and not is_installed("zarr"):
        here, oldest = (".".join(map(str, version[:2])) for version in (sys.version_info, MIN_PYTHON))
        raise BadInput(f"data sets need Python {oldest} or newer, as zarr 3 does; this is {here}")
    require("zarr", extra="data", to="read and write data sets")
    return open_storage(location)


def create_dataset(location: Path | str | Storage, settings: DatasetSettings) -> Storage:
    """Start a data set, or check that the existing one has the same settings. Safe to call from several processes.

    Raises:
        BadInput: The folder holds something else, or a data set with other settings.
    """
    storage = dataset_storage(location)
    manifest = read_manifest(storage)
    if manifest is None:
        if unknown := set(storage.names("")) - TOP_LEVEL:
            raise BadInput(f"{storage.location}: exists ({min(unknown)}) and is not a data set; use another folder")
        storage.create(MANIFEST, json.dumps(settings.manifest(), indent=1).encode())
        manifest = read_manifest(storage)
        assert manifest is not None
    _require_format(storage, manifest)
    for key, value in json.loads(json.dumps(settings.manifest())).items():
        if manifest.get(key) != value:
            difference = _difference(key, manifest.get(key), value)
            raise BadInput(f"{storage.location}: made with another {difference}; use another folder")
    # The first manifest decides; everything that follows from it can be written by anyone, also after a kill.
    arrays = dict(array_header(name, settings.resolution) for name in PATTERN_ARRAYS)
    for key, data in {**encode_mesh(settings.shape.mesh), **group_headers(), **arrays}.items():
        storage.create(key, data)
    storage.remove_stale()
    return storage


def read_manifest(storage: Storage) -> dict[str, Any] | None:
    """The content of `dataset.json`, None if there is none.

    Raises:
        BadInput: It cannot be read."""
    data = storage.read(MANIFEST, MAX_JSON_BYTES)
    try:
        return None if data is None else parse_json(data)
    except ValueError as error:
        raise _unreadable(storage, error) from error


def read_settings(storage: Storage) -> DatasetSettings:
    """The settings of a data set.

    Raises:
        BadInput: There is no data set, or it has another format, or is damaged."""
    manifest = read_manifest(storage)
    if manifest is None:
        raise BadInput(f"{storage.location}: not a data set (no {MANIFEST}); make one with deepfracture simulate")
    _require_format(storage, manifest)
    try:
        shape = manifest["shape"]
        arrays = []
        for name in MESH_ARRAYS:
            rows, data = int(shape[name]), storage.read(mesh_key(name), MAX_MESH * 24)
            if not 0 < rows <= MAX_MESH:
                raise ValueError(f"a mesh of {rows} {name}")
            if data is None:
                raise ValueError(f"no {mesh_key(name)}; rerun the simulate command that started it to write it again")
            arrays.append(decode_mesh_array(name, data, rows))
        mesh = Mesh(*arrays)
        if mesh_digest(mesh) != shape["sha256"]:
            raise ValueError("the mesh does not match its sha256")
        return DatasetSettings.from_manifest(manifest, mesh)
    except BadInput:
        raise
    except (ValueError, KeyError, TypeError, RuntimeError, OverflowError) as error:
        raise _unreadable(storage, error) from error


def mesh_digest(mesh: Mesh) -> str:
    """SHA-256 of a mesh."""
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()


def short_message(error: Exception) -> str:
    """The first line of an error, at most 300 characters."""
    text = str(error).split("\n")[0][:300]
    return f"no {text}" if isinstance(error, KeyError) else text or type(error).__name__


def _require_format(storage: Storage, manifest: dict[str, Any]) -> None:
    found = manifest.get("format")
    if found != FORMAT:
        raise _unreadable(storage, ValueError(f"format {str(found)[:40]}, this program reads {FORMAT}"))


def _unreadable(storage: Storage, error: Exception) -> BadInput:
    return BadInput(f"{storage.location}/{MANIFEST}: not a readable data set: {short_message(error)}")


def _difference(key: str, have: Any, want: Any) -> str:
    """The first entry that differs, at any depth."""
    if isinstance(have, dict) and isinstance(want, dict):
        for inner in want:
            if have.get(inner) != want[inner]:
                return _difference(f"{key} {inner}", have.get(inner), want[inner])
    return f"{key}: {have}, not {want}"
