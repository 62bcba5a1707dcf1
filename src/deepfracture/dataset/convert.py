"""Bring a data set to another place, or one of a former format to this one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from deepfracture.dataset.arrays import shards
from deepfracture.dataset.former import former_entries, former_entry, former_settings
from deepfracture.dataset.storage import NotReached, Storage, storage_at
from deepfracture.dataset.store import (
    Dataset,
    Settings,
    create,
    done,
    one_line,
    open_dataset,
    put,
    read_manifest,
    read_records,
    read_settings,
    stored_objects,
    unreadable,
)
from deepfracture.runtime.progress import log, track
from deepfracture.types import BadInput, Grid

FORMER = (1, 2)
ABREAST = 8
"""Entries on their way at once."""


def convert(old: Path | str, new: Path | str) -> tuple[Dataset, int]:
    """Copy the data set `old`, of any format, to `new`, in this one; what `new` holds already is kept.

    Entries are copied as they are, and every byte is checked against its hash on the way; those that are damaged are
    left out, so that `simulate` can make them anew.

    Returns:
        The new data set, and how many entries of the old one are damaged.

    Raises:
        BadInput: There is no data set, or `new` is something else, or of other settings.
    """
    source = storage_at(old)
    manifest = read_manifest(source)
    if manifest is None:
        raise BadInput(f"{source.place}: not a data set; name one made by deepfracture simulate")
    if source == storage_at(new):
        raise BadInput(f"{source.place}: cannot be converted onto itself; name another folder")
    if manifest.get("format") in FORMER:
        try:
            settings = former_settings(source, manifest)
        except NotReached:
            raise
        except (ValueError, KeyError, TypeError, RuntimeError, OverflowError) as error:
            raise unreadable(source, error) from error
        target = create(new, settings)
        damaged = _renew(source, target, settings)
    else:
        settings = read_settings(source)
        target = create(new, settings)
        damaged = _copy(source, target, settings)
    return open_dataset(target), damaged


def _renew(source: Storage, target: Storage, settings: Settings) -> int:
    grid, there = Grid(settings.resolution), done(target)
    places = {number: place for number, place in former_entries(source).items() if number not in there}

    def one(number: int) -> None:
        record, pattern = former_entry(source, number, places[number], grid)
        put(target, record, None if pattern is None else shards(pattern))

    return _all(source, one, sorted(places))


def _copy(source: Storage, target: Storage, settings: Settings) -> int:
    records, damaged = read_records(source)
    there = done(target)
    missing = {record.number: record for record in records if record.number not in there}

    def one(number: int) -> None:
        record = missing[number]
        put(target, replace(record, objects={}), stored_objects(source, settings.resolution, record))

    for number, problem in damaged.items():
        log.warning("%s: entry %06d left out: %s", source.place, number, problem)
    return len(damaged) + _all(source, one, sorted(missing))


def _all(source: Storage, one: Callable[[int], None], numbers: list[int]) -> int:
    """Do `one` for all numbers, some at once; how many are damaged."""

    def tried(number: int) -> str | None:
        try:
            one(number)
        except NotReached:
            raise
        except (ValueError, KeyError, TypeError, RuntimeError, OverflowError) as error:
            return f"entry {number:06d} left out: {one_line(error)}"
        return None

    def results() -> Iterator[str | None]:
        with ThreadPoolExecutor(ABREAST) as threads:
            try:
                yield from threads.map(tried, numbers)
            finally:
                threads.shutdown(wait=True, cancel_futures=True)

    problems = [problem for problem in track(results(), name="entries", total=len(numbers)) if problem is not None]
    for problem in problems:
        log.warning("%s: %s", source.place, problem)
    return len(problems)
