"""Copy a data set between folders and buckets, verifying every byte."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from deepfracture.dataset.dataset import Dataset, open_dataset
from deepfracture.dataset.entries import read_objects, read_records, recorded, write_entry
from deepfracture.dataset.settings import create_dataset, dataset_storage, read_settings, short_message
from deepfracture.dataset.storage import StorageError
from deepfracture.runtime.progress import log, track
from deepfracture.types import BadInput

MAX_TRANSFERS = 8
"""Entries copied concurrently."""


def copy_dataset(source: Path | str, target: Path | str) -> tuple[Dataset, int]:
    """Copy the data set `source` to `target`, byte for byte; entries that `target` already holds are kept.

    Every object is checked against its hash on the way. Damaged entries are left out: `simulate` fills the gaps.

    Returns:
        The copy, and the number of damaged entries of `source`.

    Raises:
        BadInput: There is no data set, or `target` is something else, or has other settings.
    """
    here = dataset_storage(source)
    settings = read_settings(here)
    if here == dataset_storage(target):
        raise BadInput(f"{here.location}: cannot be copied onto itself; name another folder")
    there = create_dataset(target, settings)
    records, damaged = read_records(here)
    existing = recorded(there)
    missing = {record.number: record for record in records if record.number not in existing}

    def copy(number: int) -> None:
        record = missing[number]
        write_entry(there, replace(record, objects={}), read_objects(here, record, settings.resolution))

    damaged |= _for_each(sorted(missing), copy)
    for number, problem in damaged.items():
        log.warning("%s: entry %06d left out: %s", here.location, number, problem)
    return open_dataset(there), len(damaged)


def _for_each(numbers: list[int], copy: Callable[[int], None]) -> dict[int, str]:
    """Run `copy` for all numbers, several at once. Returns what is wrong with damaged ones, by number."""

    def problem(number: int) -> str | None:
        try:
            copy(number)
        except StorageError:
            raise
        except (ValueError, KeyError, TypeError, RuntimeError, OverflowError) as error:
            return short_message(error)
        return None

    def problems() -> Iterator[str | None]:
        with ThreadPoolExecutor(MAX_TRANSFERS) as threads:
            try:
                yield from threads.map(problem, numbers)
            finally:
                threads.shutdown(wait=True, cancel_futures=True)

    found = zip(numbers, track(problems(), name="entries", total=len(numbers)), strict=True)
    return {number: text for number, text in found if text is not None}
