"""A data set of simulated collisions: in a folder or a bucket, written by many processes, resumed after any kill.

    dataset.json            the settings: shape, material, kind of scene, resolution, speeds, seed
    zarr.json               makes the folder a zarr group
    shape/                  vertices and faces of the mesh
    labels/c/12/0/0/0       entry 12 of the array `labels`, shape (1000000, r, r, r)
    distance/c/12/0/0/0     entry 12 of `distance`
    entries/000012.json     the record: broken (impact, seed, hashes), unbroken or failed (with the reason)

With repeats R, entry k R + i is repeat i of collision k. An entry exists if its record does, and the record is written
last: there is nothing to undo after a kill, and no counter that could disagree. Processes that write the same entry
write the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from deepfracture.dataset.entries import RETRY_ADVICE, Sample, read_pattern, read_records, read_sample
from deepfracture.dataset.record import Record, record_key
from deepfracture.dataset.settings import DatasetSettings, dataset_storage, read_settings, short_message
from deepfracture.dataset.storage import Storage, StorageError
from deepfracture.runtime.progress import track
from deepfracture.types import BadInput, Impact, Material, Shape


@dataclass(frozen=True, eq=False)
class Dataset:
    """Samples in a folder or bucket; `dataset[i]` reads the i-th one, nothing is cached."""

    storage: Storage
    settings: DatasetSettings
    records: tuple[Record, ...]
    """Results of all simulated collisions, in ascending order."""

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Sample:
        return read_sample(self.storage, self.samples[index], self.settings.resolution)

    def __iter__(self) -> Iterator[Sample]:
        return (self[i] for i in range(len(self)))

    @property
    def path(self) -> str:
        """Folder or s3:// address."""
        return self.storage.location

    @property
    def name(self) -> str:
        """Last component of the path."""
        return Path(self.path).name

    @property
    def shape(self) -> Shape:
        return self.settings.shape

    @property
    def material(self) -> Material:
        return self.settings.material

    @cached_property
    def samples(self) -> tuple[Record, ...]:
        """Records of the collisions that broke the shape."""
        return tuple(record for record in self.records if record.kind == "broken")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the samples' entries, in ascending order."""
        return tuple(record.name for record in self.samples)

    @property
    def unbroken(self) -> int:
        """Number of collisions without fracture."""
        return sum(record.kind == "unbroken" for record in self.records)

    @property
    def failed(self) -> int:
        """Number of collisions that could not be simulated."""
        return sum(record.kind == "failed" for record in self.records)

    @property
    def tried(self) -> int:
        """Number of simulated collisions, repeats counted singly, whatever their result."""
        return len(self.records)

    def collisions(self) -> list[tuple[int, ...]]:
        """Indices of the samples, grouped by collision."""
        groups: dict[int, list[int]] = {}
        for index, record in enumerate(self.samples):
            groups.setdefault(record.number // self.settings.repeats, []).append(index)
        return [tuple(indices) for indices in groups.values()]

    def impacts(self) -> list[Impact]:
        """The impact of every sample, without reading the patterns."""
        return [record.impact for record in self.samples if record.impact is not None]

    @cached_property
    def max_impulse(self) -> float:
        """I_max of the paper: the largest impulse of any sample [N s]."""
        if not len(self):
            raise BadInput(f"{self.path}: no collision broke the shape yet; simulate more or faster ones")
        return max(float(impact.magnitude[0]) for impact in self.impacts())


def open_dataset(location: Path | str | Storage) -> Dataset:
    """The data set in a folder or at an s3:// address, finished or not.

    Raises:
        BadInput: There is none, or its manifest, its shape or a record cannot be read.
    """
    storage = dataset_storage(location)
    settings = read_settings(storage)
    records, damaged = read_records(storage)
    for number, problem in damaged.items():
        more = f" and {len(damaged) - 1} more" if len(damaged) > 1 else ""
        raise BadInput(f"{storage.location}: {record_key(number)}{more}: damaged ({problem}); {RETRY_ADVICE}")
    return Dataset(storage, settings, records)


def verify_dataset(location: Path | str | Storage) -> tuple[Dataset, dict[int, str]]:
    """Read every byte of a data set: its intact entries, and for damaged ones, by number, what is wrong.

    Raises:
        BadInput: There is none, or its manifest or shape cannot be read.
    """
    storage = dataset_storage(location)
    settings = read_settings(storage)
    records, damaged = read_records(storage)
    for record in track(records, name="entries"):
        try:
            if record.kind == "broken":
                read_pattern(storage, record, settings.resolution)
        except StorageError:
            raise
        except (ValueError, RuntimeError) as error:
            damaged[record.number] = short_message(error)
    intact = tuple(record for record in records if record.number not in damaged)
    return Dataset(storage, settings, intact), damaged


def discard_incomplete(storage: Storage) -> int:
    """Delete the records of failed and damaged entries, so that they are simulated again. Returns how many."""
    intact, damaged = verify_dataset(storage)
    discarded = {*damaged, *(record.number for record in intact.records if record.kind == "failed")}
    for number in discarded:
        storage.delete(record_key(number))
    return len(discarded)
