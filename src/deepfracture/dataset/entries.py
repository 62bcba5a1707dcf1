"""The entries of a data set: one per simulated collision, written whole or not at all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from deepfracture.dataset.arrays import decode_pattern, encode_pattern, max_shard_bytes, shard_key
from deepfracture.dataset.record import (
    MAX_JSON_BYTES,
    RECORD_FOLDER,
    RECORD_NAME,
    ObjectInfo,
    Record,
    read_record,
    record_key,
)
from deepfracture.dataset.settings import short_message
from deepfracture.dataset.storage import Storage, StorageError, open_storage
from deepfracture.types import BadInput, FracturePattern, Grid, Impact

RETRY_ADVICE = "simulate with --retry to replace it"


@dataclass(frozen=True, eq=False)
class Sample:
    """One collision that broke the shape."""

    impact: Impact
    pattern: FracturePattern
    seed: int
    """`np.random.default_rng(seed)` replays this collision."""


def recorded(location: Path | str | Storage) -> set[int]:
    """Numbers of the entries that have a record."""
    names = open_storage(location).names(RECORD_FOLDER)
    return {int(match[1]) for name in names if (match := RECORD_NAME.fullmatch(name))}


def read_records(storage: Storage) -> tuple[tuple[Record, ...], dict[int, str]]:
    """The records of all entries in ascending order, and for damaged ones, by number, what is wrong."""
    numbers = sorted(recorded(storage))
    records, damaged = [], {}
    files = storage.read_all([record_key(number) for number in numbers], MAX_JSON_BYTES)
    for number, data in zip(numbers, files, strict=True):
        try:
            if isinstance(data, BadInput):
                raise data
            if data is not None:  # another process may have deleted it
                records.append(read_record(number, data))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            damaged[number] = short_message(error)
    return tuple(records), damaged


def read_sample(storage: Storage, record: Record, resolution: int) -> Sample:
    """The sample of a record.

    Raises:
        BadInput: Its objects are not those that the record describes."""
    assert record.impact is not None
    try:
        pattern = read_pattern(storage, record, resolution)
    except StorageError:
        raise
    except (ValueError, RuntimeError) as error:
        raise BadInput(
            f"{storage.location}: entry {record.name}: damaged sample ({short_message(error)}); {RETRY_ADVICE}"
        ) from error
    return Sample(record.impact, pattern, record.seed)


def read_pattern(storage: Storage, record: Record, resolution: int) -> FracturePattern:
    """The pattern of a record.

    Raises:
        ValueError, RuntimeError: Its objects are not those that the record describes."""
    pattern = decode_pattern(read_objects(storage, record, resolution), Grid(resolution))
    if pattern.count != record.fragments:
        raise ValueError(f"{pattern.count} fragments, the record says {record.fragments}")
    return pattern


def read_objects(storage: Storage, record: Record, resolution: int) -> dict[str, bytes]:
    """The objects of a record by array name, byte for byte.

    Raises:
        ValueError: One is missing or differs from its hash."""
    found = {}
    for name, info in record.objects.items():
        key = shard_key(name, record.number)
        data = storage.read(key, max_shard_bytes(name, resolution)) if info.size else b""
        if data is None:
            raise ValueError(f"no {key}")
        if ObjectInfo.of(data) != info:
            raise ValueError(f"{key} differs from its sha256 in the record")
        found[name] = data
    return found


def write_sample(location: Path | str | Storage, number: int, sample: Sample) -> None:
    """Store an entry that broke the shape."""
    record = Record(number, "broken", sample.seed, sample.impact, sample.pattern.count)
    write_entry(location, record, encode_pattern(sample.pattern))


def write_unbroken(location: Path | str | Storage, number: int, impact: Impact | None, seed: int) -> None:
    """Store an entry without fracture (`impact` is None if the ball missed)."""
    impulse, speed = (None, None) if impact is None else (float(impact.magnitude[0]), impact.speed)
    write_entry(location, Record(number, "unbroken", seed, impulse=impulse, speed=speed))


def write_failed(location: Path | str | Storage, number: int, reason: str, seed: int) -> None:
    """Store why an entry could not be simulated."""
    write_entry(location, Record(number, "failed", seed, reason=reason))


def write_entry(location: Path | str | Storage, record: Record, objects: dict[str, bytes] | None = None) -> None:
    """Store an entry unless it exists: its objects, then the record that makes them count."""
    storage = open_storage(location)
    if storage.read(record.key, MAX_JSON_BYTES) is not None:
        return
    objects = objects or {}
    for name, data in objects.items():
        if data:
            storage.write(shard_key(name, record.number), data)
    described = {name: ObjectInfo.of(data) for name, data in objects.items()}
    storage.create(record.key, replace(record, objects=described).to_bytes())
