"""A folder of simulated collisions that can be killed and continued at any moment.

    dataset.json        what was simulated: shape, material, kind of scene, resolution, speeds, seed
    shape/              zarr group: vertices, faces
    samples/000012/     zarr group: labels, distance; its attributes hold the impact and the seed
                        (with repeats R, entry k R + i is repeat i of collision k)
    unbroken/000013.json    a collision that broke nothing
    failed/000014.json      one that could not be simulated, and why

Every entry is written under another name and moved into place, so it is whole or not there. What
has been tried is what lies in the folder: no counter can disagree with it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from deepfracture.extras import has, need
from deepfracture.types import BadInput, FracturePattern, Grid, Impact, Material, Mesh, Shape

OLDEST = (3, 11)
"""Python for which there is zarr 3."""
FORMAT = 2
"""Of the manifest."""
UNSAID = {"scene": "single", "refracture": 0, "frames": 0, "repeats": 1}
"""What older manifests do not say, and what their data sets are."""
MANIFEST = "dataset.json"
KINDS = ("samples", "unbroken", "failed")
"""What can become of a collision: a folder each."""
IMPACT_FIELDS = ("position", "direction", "magnitude", "normal")


@dataclass(frozen=True, eq=False)
class Sample:
    """One collision that broke the shape."""

    impact: Impact
    pattern: FracturePattern
    seed: int
    """`np.random.default_rng(seed)` replays this collision."""


@dataclass(frozen=True, eq=False)
class Settings:
    """All that decides what collision k of a data set looks like."""

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
    """Times that each collision is simulated, the weak places of the material elsewhere each time."""

    def manifest(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "shape": {
                "name": self.shape.name,
                "scale": self.shape.scale,
                "centre": self.shape.centre.tolist(),
                "mesh": _digest(self.shape.mesh),
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


@dataclass(frozen=True, eq=False)
class Dataset:
    """A folder of samples; `dataset[i]` reads the i-th one from disk."""

    path: Path
    settings: Settings
    names: tuple[str, ...]
    """Folders of the samples, in the order of their collisions."""
    unbroken: int
    """Collisions that broke nothing."""
    failed: int
    """Collisions that could not be simulated."""

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> Sample:
        return _read_sample(self.path / "samples" / self.names[index], Grid(self.settings.resolution))

    def __iter__(self) -> Iterator[Sample]:
        return (self[i] for i in range(len(self)))

    @property
    def shape(self) -> Shape:
        return self.settings.shape

    @property
    def material(self) -> Material:
        return self.settings.material

    @property
    def tried(self) -> int:
        """Collisions simulated, each repeat for itself, whatever became of them."""
        return len(self) + self.unbroken + self.failed

    def collisions(self) -> list[tuple[int, ...]]:
        """Samples of the same collision together: indices into this data set, collision by collision."""
        found: dict[int, list[int]] = {}
        for index, name in enumerate(self.names):
            found.setdefault(int(name) // self.settings.repeats, []).append(index)
        return [tuple(indices) for indices in found.values()]

    def impacts(self) -> list[Impact]:
        """The impact of every sample, without reading the patterns."""
        return [_read_impact(self.path / "samples" / name)[0] for name in self.names]

    @cached_property
    def max_impulse(self) -> float:
        """I_max of the paper: the largest impulse of any sample [N s]."""
        if not len(self):
            raise BadInput(f"{self.path}: no collision broke the shape yet; simulate more or faster ones")
        return max(float(impact.magnitude[0]) for impact in self.impacts())


def open_dataset(path: Path | str) -> Dataset:
    """The data set in the folder `path`, finished or not.

    Raises:
        BadInput: `path` is not a data set, or its manifest or shape cannot be read.
    """
    _need_zarr()
    path = Path(path)
    file = path / MANIFEST
    if not file.is_file():
        raise BadInput(f"{path}: not a data set (no {MANIFEST}); make one with deepfracture simulate")
    try:
        settings = _settings(path, json.loads(file.read_text()))
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise BadInput(f"{file}: not a readable data set: {_one_line(error)}") from error
    samples = tuple(sorted(_entries(path / "samples")))
    return Dataset(path, settings, samples, len(_entries(path / "unbroken")), len(_entries(path / "failed")))


def create(path: Path, settings: Settings) -> None:
    """Start a data set in `path`, or check that the one there has the same settings.

    Raises:
        BadInput: The folder holds something else, or a data set of other settings.
    """
    _need_zarr()
    wanted = settings.manifest()
    file = path / MANIFEST
    if file.is_file():
        have = open_dataset(path).settings.manifest()
        for key, value in wanted.items():
            if have[key] != value:
                raise BadInput(f"{path}: made with another {_difference(key, have[key], value)}; use another folder")
        return
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise BadInput(f"{path}: exists and is not a data set; use another folder")
    for name in KINDS:
        (path / name).mkdir(parents=True, exist_ok=True)
    _write_shape(path / "shape", settings.shape.mesh)
    _write_text(file, json.dumps(wanted, indent=1))


def _need_zarr() -> None:
    """Every data set comes from `create` or `open_dataset`, which ask for the library before they touch a file."""
    if sys.version_info < OLDEST and not has("zarr"):
        here, oldest = (".".join(map(str, version[:2])) for version in (sys.version_info, OLDEST))
        raise BadInput(f"data sets need Python {oldest} or newer, as zarr 3 does; this is {here}")
    need("zarr", extra="data", to="read and write data sets")


def done(path: Path) -> set[int]:
    """Collisions that have been dealt with, by number."""
    return {int(name.split(".")[0]) for kind in KINDS for name in _entries(path / kind)}


def write_sample(path: Path, k: int, sample: Sample) -> None:
    """Store collision `k`, which broke the shape."""
    import zarr

    target = path / "samples" / f"{k:06d}"
    scratch = _scratch(target)
    labels = sample.pattern.labels
    small = np.uint8 if labels.max() < 256 else np.uint16
    impact = sample.impact
    group = zarr.open_group(scratch, mode="w")
    _store(group, "labels", labels.astype(small))
    _store(group, "distance", sample.pattern.distance.astype(np.float16))
    group.attrs.update(
        {
            "seed": sample.seed,
            "speed": impact.speed,
            "radius": impact.radius,
            **{name: getattr(impact, name).tolist() for name in IMPACT_FIELDS},
        }
    )
    os.replace(scratch, target)


def write_unbroken(path: Path, k: int, impact: Impact | None, seed: int) -> None:
    """Record that collision `k` broke nothing (`impact` is None when the ball missed)."""
    strength = None if impact is None else {"impulse": float(impact.magnitude[0]), "speed": impact.speed}
    _write_text(path / "unbroken" / f"{k:06d}.json", json.dumps({"seed": seed, "impact": strength}))


def write_failed(path: Path, k: int, reason: str, seed: int) -> None:
    """Record why collision `k` could not be simulated."""
    (path / "failed").mkdir(exist_ok=True)  # sets of older versions have none
    _write_text(path / "failed" / f"{k:06d}.json", json.dumps({"seed": seed, "reason": reason}))


def _entries(folder: Path) -> list[str]:
    return [entry.name for entry in folder.iterdir() if entry.name[:6].isdigit()] if folder.is_dir() else []


def _read_impact(folder: Path) -> tuple[Impact, int]:
    try:
        about = json.loads((folder / "zarr.json").read_text())["attributes"]
        arrays = {name: about[name] for name in IMPACT_FIELDS}
        return Impact(**arrays, speed=float(about["speed"]), radius=float(about["radius"])), int(about["seed"])
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise BadInput(f"{folder}: damaged sample: {_one_line(error)}; delete it and simulate again") from error


def _read_sample(folder: Path, grid: Grid) -> Sample:
    import zarr

    impact, seed = _read_impact(folder)
    try:
        group = zarr.open_group(folder, mode="r")
        labels, distance = np.asarray(group["labels"]), np.asarray(group["distance"])
        return Sample(impact, FracturePattern(grid, labels, distance), seed)
    except Exception as error:  # zarr and its codecs raise errors of many kinds on damaged files
        raise BadInput(f"{folder}: damaged sample: {_one_line(error)}; delete it and simulate again") from error


def _settings(path: Path, manifest: dict[str, Any]) -> Settings:
    import zarr

    if manifest["format"] not in (1, FORMAT):
        raise ValueError(f"format {manifest['format']}, this program reads 1 and {FORMAT}")
    manifest = UNSAID | manifest
    group = zarr.open_group(path / "shape", mode="r")
    mesh = Mesh(np.asarray(group["vertices"]), np.asarray(group["faces"]))
    about = manifest["shape"]
    if _digest(mesh) != about["mesh"]:
        raise ValueError("the mesh beside it is another one")
    shape = Shape(about["name"], mesh, about["scale"], about["centre"])
    slow, fast = manifest["speed_range"]
    resolution, seed = Grid(manifest["resolution"]).resolution, int(manifest["seed"])
    material = Material(**manifest["material"])
    speed_range = (float(slow), float(fast))
    again = int(manifest["refracture"]), int(manifest["frames"]), int(manifest["repeats"])
    return Settings(shape, material, resolution, seed, speed_range, str(manifest["scene"]), *again)


def _write_shape(target: Path, mesh: Mesh) -> None:
    import zarr

    scratch = _scratch(target)
    group = zarr.open_group(scratch, mode="w")
    _store(group, "vertices", mesh.vertices)
    _store(group, "faces", mesh.faces)
    shutil.rmtree(target, ignore_errors=True)  # of a start that never reached its manifest
    os.replace(scratch, target)


def _store(group: Any, name: str, values: np.ndarray) -> None:
    from zarr.codecs import ZstdCodec

    array = group.create_array(
        name, shape=values.shape, chunks=values.shape, dtype=values.dtype, compressors=ZstdCodec(level=7)
    )
    array[...] = values


def _write_text(target: Path, text: str) -> None:
    scratch = _scratch(target)
    scratch.write_text(text)
    os.replace(scratch, target)


def _scratch(target: Path) -> Path:
    return target.with_name(f".{target.name}.{os.getpid()}")


def _digest(mesh: Mesh) -> str:
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()[:16]


def _difference(key: str, have: Any, want: Any) -> str:
    """The first entry that differs, however deep."""
    if isinstance(have, dict) and isinstance(want, dict):
        for inner in want:
            if have.get(inner) != want[inner]:
                return _difference(f"{key} {inner}", have.get(inner), want[inner])
    return f"{key}: {have}, not {want}"


def _one_line(error: Exception) -> str:
    text = str(error).split("\n")[0]
    return f"no {text}" if isinstance(error, KeyError) else text or type(error).__name__
