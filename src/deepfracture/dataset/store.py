"""A data set of simulated collisions: in a folder or a bucket, killed and continued at any moment, by many at once.

    dataset.json            what was simulated: shape, material, kind of scene, resolution, speeds, seed
    zarr.json               the folder is a zarr group
    shape/                  vertices and faces of the mesh
    labels/c/12/0/0/0       entry 12 of the array `labels`, shape (1000000, r, r, r)
    distance/c/12/0/0/0     ... and of `distance`
    entries/000012.json     what became of it: broken (impact, seed, hashes), unbroken or failed (and why)

With repeats R, entry k R + i is repeat i of collision k. An entry exists if its record does, and the record is written
last: there is nothing to undo after a kill, and no counter that could disagree. Who writes an entry twice writes the
same bytes.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from deepfracture.dataset.arrays import (
    ARRAYS,
    SHAPE,
    array_header,
    entry_key,
    headers,
    largest_shard,
    mesh_key,
    mesh_objects,
    mesh_values,
    pattern_of,
    shards,
)
from deepfracture.dataset.record import FOLDER, LARGEST, NAME, Record, Stored, parse, read_record, record_key
from deepfracture.dataset.storage import NotReached, Storage, storage_at
from deepfracture.runtime.extras import is_installed, require
from deepfracture.runtime.progress import track
from deepfracture.types import BadInput, FracturePattern, Grid, Impact, Material, Mesh, Shape

OLDEST = (3, 11)
"""Python for which there is zarr 3."""
FORMAT = 3
"""Of the manifest."""
MANIFEST = "dataset.json"
OWN = {MANIFEST, "zarr.json", "shape", "labels", "distance", FOLDER}
"""What lies in a data set."""
LARGEST_MESH = 20_000_000
"""Vertices or faces of a mesh that is still read."""
AGAIN = "simulate with --retry makes it anew"


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
        mesh = self.shape.mesh
        return {
            "format": FORMAT,
            "shape": {
                "name": self.shape.name,
                "scale": self.shape.scale,
                "centre": self.shape.centre.tolist(),
                "vertices": len(mesh.vertices),
                "faces": len(mesh.faces),
                "sha256": digest(mesh),
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
    def of(manifest: dict[str, Any], mesh: Mesh) -> Settings:
        """What a manifest says.

        Raises:
            ValueError, KeyError, TypeError: It does not say it."""
        about = manifest["shape"]
        slow, fast = manifest["speed_range"]
        return Settings(
            Shape(str(about["name"]), mesh, float(about["scale"]), about["centre"]),
            Material(**manifest["material"]),
            Grid(manifest["resolution"]).resolution,
            int(manifest["seed"]),
            (float(slow), float(fast)),
            str(manifest["scene"]),
            *(int(manifest[name]) for name in ("refracture", "frames", "repeats")),
        )


@dataclass(frozen=True, eq=False)
class Dataset:
    """Samples in a folder or bucket; `dataset[i]` reads the i-th one, and nothing is kept."""

    storage: Storage
    settings: Settings
    records: tuple[Record, ...]
    """What became of every collision that was tried, in their order."""

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Sample:
        return read_sample(self.storage, self.settings, self.samples[index])

    def __iter__(self) -> Iterator[Sample]:
        return (self[i] for i in range(len(self)))

    @property
    def path(self) -> str:
        """Folder or s3:// address."""
        return self.storage.place

    @property
    def name(self) -> str:
        """The last word of the path."""
        return Path(self.path).name

    @property
    def shape(self) -> Shape:
        return self.settings.shape

    @property
    def material(self) -> Material:
        return self.settings.material

    @cached_property
    def samples(self) -> tuple[Record, ...]:
        """The collisions that broke the shape."""
        return tuple(record for record in self.records if record.kind == "broken")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Entries of the samples, in the order of their collisions."""
        return tuple(record.name for record in self.samples)

    @property
    def unbroken(self) -> int:
        """Collisions that broke nothing."""
        return sum(record.kind == "unbroken" for record in self.records)

    @property
    def failed(self) -> int:
        """Collisions that could not be simulated."""
        return sum(record.kind == "failed" for record in self.records)

    @property
    def tried(self) -> int:
        """Collisions simulated, each repeat for itself, whatever became of them."""
        return len(self.records)

    def collisions(self) -> list[tuple[int, ...]]:
        """Samples of the same collision together: indices into this data set, collision by collision."""
        found: dict[int, list[int]] = {}
        for index, record in enumerate(self.samples):
            found.setdefault(record.number // self.settings.repeats, []).append(index)
        return [tuple(indices) for indices in found.values()]

    def impacts(self) -> list[Impact]:
        """The impact of every sample, without reading the patterns."""
        return [record.impact for record in self.samples if record.impact is not None]

    @cached_property
    def max_impulse(self) -> float:
        """I_max of the paper: the largest impulse of any sample [N s]."""
        if not len(self):
            raise BadInput(f"{self.path}: no collision broke the shape yet; simulate more or faster ones")
        return max(float(impact.magnitude[0]) for impact in self.impacts())


def open_dataset(path: Path | str | Storage) -> Dataset:
    """The data set in a folder or at an s3:// address, finished or not.

    Raises:
        BadInput: There is none, or its manifest, its shape or a record cannot be read.
    """
    storage = _usable(path)
    settings = read_settings(storage)
    records, damaged = read_records(storage)
    for number, problem in damaged.items():
        more = f" and {len(damaged) - 1} more" if len(damaged) > 1 else ""
        raise BadInput(f"{storage.place}: {record_key(number)}{more}: damaged ({problem}); {AGAIN}")
    return Dataset(storage, settings, records)


def read_manifest(storage: Storage) -> dict[str, Any] | None:
    """What `dataset.json` says, None if there is none.

    Raises:
        BadInput: It cannot be read."""
    data = storage.read(MANIFEST, LARGEST)
    try:
        return None if data is None else parse(data)
    except ValueError as error:
        raise unreadable(storage, error) from error


def read_settings(storage: Storage) -> Settings:
    """What was simulated.

    Raises:
        BadInput: There is no data set, or it is of another format, or damaged."""
    manifest = read_manifest(storage)
    if manifest is None:
        raise BadInput(f"{storage.place}: not a data set (no {MANIFEST}); make one with deepfracture simulate")
    _of_this_format(storage, manifest)
    try:
        about = manifest["shape"]
        parts = []
        for name in SHAPE:
            rows, data = int(about[name]), storage.read(mesh_key(name), LARGEST_MESH * 24)
            if not 0 < rows <= LARGEST_MESH:
                raise ValueError(f"a mesh of {rows} {name}")
            if data is None:
                raise ValueError(f"no {mesh_key(name)}; the simulate command that began it writes it again")
            parts.append(mesh_values(name, data, rows))
        mesh = Mesh(*parts)
        if digest(mesh) != about["sha256"]:
            raise ValueError("the mesh beside it is another one")
        return Settings.of(manifest, mesh)
    except BadInput:
        raise
    except (ValueError, KeyError, TypeError, RuntimeError, OverflowError) as error:
        raise unreadable(storage, error) from error


def read_records(storage: Storage) -> tuple[tuple[Record, ...], dict[int, str]]:
    """The record of every entry, in their order, and for those that are damaged how."""
    numbers = sorted(done(storage))
    records, damaged = [], {}
    for number, data in zip(
        numbers, storage.read_all([record_key(number) for number in numbers], LARGEST), strict=True
    ):
        try:
            if isinstance(data, BadInput):
                raise data
            if data is not None:  # it may have been removed meanwhile
                records.append(read_record(number, data))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            damaged[number] = one_line(error)
    return tuple(records), damaged


def read_sample(storage: Storage, settings: Settings, record: Record) -> Sample:
    """The sample that a record tells of.

    Raises:
        BadInput: Its objects are not those that the record tells of."""
    assert record.impact is not None
    try:
        pattern = _pattern(storage, settings, record)
    except NotReached:
        raise
    except (ValueError, RuntimeError) as error:
        raise BadInput(f"{storage.place}: entry {record.name}: damaged sample ({one_line(error)}); {AGAIN}") from error
    return Sample(record.impact, pattern, record.seed)


def _pattern(storage: Storage, settings: Settings, record: Record) -> FracturePattern:
    pattern = pattern_of(stored_objects(storage, settings.resolution, record), Grid(settings.resolution))
    if pattern.count != record.fragments:
        raise ValueError(f"{pattern.count} fragments, the record says {record.fragments}")
    return pattern


def stored_objects(storage: Storage, resolution: int, record: Record) -> dict[str, bytes]:
    """The objects that a record tells of, byte for byte.

    Raises:
        ValueError: One is missing, or another one."""
    found = {}
    for name, stored in record.objects.items():
        key = entry_key(name, record.number)
        data = storage.read(key, largest_shard(name, resolution)) if stored.size else b""
        if data is None:
            raise ValueError(f"no {key}")
        if Stored.of(data) != stored:
            raise ValueError(f"{key} is not what was written: its sha256 is another")
        found[name] = data
    return found


def create(path: Path | str | Storage, settings: Settings) -> Storage:
    """Start a data set, or check that the one there has the same settings; several may start it at once.

    Raises:
        BadInput: The folder holds something else, or a data set of other settings.
    """
    storage = _usable(path)
    manifest = read_manifest(storage)
    if manifest is None:
        if strange := set(storage.names("")) - OWN:
            raise BadInput(f"{storage.place}: exists ({min(strange)}) and is not a data set; use another folder")
        storage.create(MANIFEST, json.dumps(settings.manifest(), indent=1).encode())
        manifest = read_manifest(storage)
        assert manifest is not None
    _of_this_format(storage, manifest)
    for key, value in json.loads(json.dumps(settings.manifest())).items():
        if manifest.get(key) != value:
            raise BadInput(
                f"{storage.place}: made with another {_difference(key, manifest.get(key), value)}; use another folder"
            )
    # The first to write the manifest has decided; what follows from it anybody may write, also after a kill.
    arrays = dict(array_header(name, settings.resolution) for name in ARRAYS)
    for key, data in {**mesh_objects(settings.shape.mesh), **headers(), **arrays}.items():
        storage.create(key, data)
    storage.remove_stale()
    return storage


def done(path: Path | str | Storage) -> set[int]:
    """Collisions that have been dealt with, by number."""
    return {int(found[1]) for name in storage_at(path).names(FOLDER) if (found := NAME.fullmatch(name))}


def write_sample(path: Path | str | Storage, k: int, sample: Sample) -> None:
    """Store collision `k`, which broke the shape."""
    put(path, Record(k, "broken", sample.seed, sample.impact, sample.pattern.count), shards(sample.pattern))


def write_unbroken(path: Path | str | Storage, k: int, impact: Impact | None, seed: int) -> None:
    """Record that collision `k` broke nothing (`impact` is None when the ball missed)."""
    impulse, speed = (None, None) if impact is None else (float(impact.magnitude[0]), impact.speed)
    put(path, Record(k, "unbroken", seed, impulse=impulse, speed=speed))


def write_failed(path: Path | str | Storage, k: int, reason: str, seed: int) -> None:
    """Record why collision `k` could not be simulated."""
    put(path, Record(k, "failed", seed, reason=reason))


def put(path: Path | str | Storage, record: Record, objects: dict[str, bytes] | None = None) -> None:
    """Store an entry unless it is there: its objects, then the record that makes them count."""
    storage = storage_at(path)
    if storage.read(record.key, LARGEST) is not None:
        return
    objects = objects or {}
    for name, data in objects.items():
        if data:
            storage.write(entry_key(name, record.number), data)
    stored = {name: Stored.of(data) for name, data in objects.items()}
    storage.create(record.key, replace(record, objects=stored).to_bytes())


def verified(path: Path | str | Storage) -> tuple[Dataset, dict[int, str]]:
    """Read every byte of a data set: what of it is whole, and for each damaged entry what is wrong with it.

    Raises:
        BadInput: There is none, or its manifest or shape cannot be read.
    """
    storage = _usable(path)
    settings = read_settings(storage)
    records, damaged = read_records(storage)
    for record in track(records, name="entries"):
        try:
            if record.kind == "broken":
                _pattern(storage, settings, record)
        except NotReached:
            raise
        except (ValueError, RuntimeError) as error:
            damaged[record.number] = one_line(error)
    whole = tuple(record for record in records if record.number not in damaged)
    return Dataset(storage, settings, whole), damaged


def forget(storage: Storage) -> int:
    """Drop the entries that failed or are damaged, so that they are simulated again; how many."""
    whole, damaged = verified(storage)
    wanted = {*damaged, *(record.number for record in whole.records if record.kind == "failed")}
    for number in wanted:
        storage.erase(record_key(number))
    return len(wanted)


def digest(mesh: Mesh) -> str:
    """SHA-256 of a mesh."""
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()


def one_line(error: Exception) -> str:
    text = str(error).split("\n")[0][:300]
    return f"no {text}" if isinstance(error, KeyError) else text or type(error).__name__


def _usable(path: Path | str | Storage) -> Storage:
    """Every data set comes from `create` or `open_dataset`, which ask for the library before they touch a file."""
    if sys.version_info < OLDEST and not is_installed("zarr"):
        here, oldest = (".".join(map(str, version[:2])) for version in (sys.version_info, OLDEST))
        raise BadInput(f"data sets need Python {oldest} or newer, as zarr 3 does; this is {here}")
    require("zarr", extra="data", to="read and write data sets")
    return storage_at(path)


def _of_this_format(storage: Storage, manifest: dict[str, Any]) -> None:
    form = manifest.get("format")
    if form in (1, 2):
        raise BadInput(
            f"{storage.place}: a data set of format {form}; deepfracture convert {storage.place} NEW renews it"
        )
    if form != FORMAT:
        raise unreadable(storage, ValueError(f"format {str(form)[:40]}, this program reads {FORMAT}"))


def unreadable(storage: Storage, error: Exception) -> BadInput:
    return BadInput(f"{storage.place}/{MANIFEST}: not a readable data set: {one_line(error)}")


def _difference(key: str, have: Any, want: Any) -> str:
    """The first entry that differs, however deep."""
    if isinstance(have, dict) and isinstance(want, dict):
        for inner in want:
            if have.get(inner) != want[inner]:
                return _difference(f"{key} {inner}", have.get(inner), want[inner])
    return f"{key}: {have}, not {want}"
