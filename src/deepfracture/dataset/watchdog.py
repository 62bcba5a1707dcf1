"""Worker processes under a watchdog: an entry that hangs, exhausts memory or kills its worker fails, not the job."""

from __future__ import annotations

import faulthandler
import math
import os
import signal
import socket
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from deepfracture.dataset.arrays import encode_pattern
from deepfracture.dataset.entries import write_entry, write_failed, write_unbroken
from deepfracture.dataset.record import MAX_JSON_BYTES, Record, record_key
from deepfracture.dataset.settings import MANIFEST, DatasetSettings, read_manifest
from deepfracture.dataset.storage import Storage, open_storage
from deepfracture.runtime.parallel import single_threaded_processes
from deepfracture.runtime.progress import disable_progress, log
from deepfracture.types import BadInput, FracturePattern, Impact, NoSolution

ATTEMPTS = 2
"""Attempts at an entry whose worker dies: another process may have caused the death."""
POLL_INTERVAL = 0.2
"""Time between two readings of a worker's memory [s]."""
GRACE_PERIOD = 30.0
"""Time beyond the limit after which a worker ends itself, should its watchdog be gone [s]."""


@dataclass(frozen=True, eq=False)
class CollisionResult:
    """The result of one collision."""

    impact: Impact | None
    """None: the ball missed."""
    pattern: FracturePattern | None
    """None: no fracture."""


Simulator: TypeAlias = Callable[[np.random.Generator, np.random.Generator | None], CollisionResult]
"""Simulates one random collision, a function of the generators alone: the first draws the scene; the second, or the
rest of the first if it is None, the material."""


@dataclass(frozen=True, eq=False)
class Job:
    """All that a worker needs to simulate any entry, on any machine that reaches `location`."""

    name: str
    """Unique."""
    location: str
    """Folder or s3:// address of the data set."""
    settings: DatasetSettings
    make_simulator: Callable[[DatasetSettings], Simulator]
    limit: float
    """Longest time for a collision [s]."""
    memory: float
    """Largest resident memory of a worker [GB]; infinite: unwatched."""


class WatchedWorker:
    """One process that simulates the entries of a job in turn, restarted whenever it is lost."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._process: Any = None
        self._connection: Connection | None = None

    def __call__(self, entry: int) -> None:
        """Simulate one entry: when this returns it is stored, at worst as failed.

        Raises:
            BadInput: The data set cannot be written, or the job makes no sense.
            NoSolution: The shape cannot be prepared within the limits.
            RuntimeError: An error in the program."""
        for attempt in range(ATTEMPTS):
            if self._process is None:
                self._start()
            assert self._connection is not None
            with suppress(OSError):  # the worker has died: `_wait` finds out
                self._connection.send(entry)
            reason = self._wait()
            if reason is None:
                return
            if reason.startswith("the worker"):
                log.info("%s: entry %d: %s, attempt %d of %d", self.job.location, entry, reason, attempt + 1, ATTEMPTS)
                continue
            break
        log.warning("%s: entry %d failed: %s", self.job.location, entry, reason)
        settings = self.job.settings
        write_failed(self.job.location, entry, reason, collision_seed(settings.seed, entry // settings.repeats))

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            assert self._connection is not None
            self._connection.close()
            self._process.kill()
            self._process.join()
            self._process = None

    def _start(self) -> None:
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        with single_threaded_processes():
            self._process = context.Process(target=_worker_main, args=(theirs, self.job), daemon=True)
            self._process.start()
        theirs.close()
        reason = self._wait()
        if reason is not None:
            raise NoSolution(f"{self.job.location}: {self.job.settings.shape.name} cannot be prepared: {reason}")

    def _wait(self) -> str | None:
        """Wait for the answer of the worker. Returns None for success, else why the worker was ended."""
        job, process, connection = self.job, self._process, self._connection
        assert connection is not None
        deadline = time.monotonic() + job.limit
        while True:
            interval = POLL_INTERVAL if math.isfinite(job.memory) else math.inf
            timeout = min(deadline - time.monotonic(), interval)
            ready = wait([connection, process.sentinel], None if math.isinf(timeout) else max(timeout, 0))
            if connection in ready:
                try:
                    error = connection.recv()
                except (EOFError, OSError):
                    ready = [process.sentinel]
                else:
                    if error is not None:
                        self.close()
                        raise error
                    return None
            reason = ""
            if process.sentinel in ready:
                process.join()
                reason = f"the worker died (exit status {process.exitcode}), perhaps for lack of memory"
            elif time.monotonic() >= deadline:
                reason = f"took longer than {job.limit:g} s"
            elif resident_memory(process.pid) > job.memory:
                reason = f"took more than {job.memory:g} GB"
            if reason:
                self.close()
                return reason


def collision_seed(seed: int, k: int) -> int:
    """The seed of collision `k`: independent streams for any seed and number."""
    return int(np.random.SeedSequence([seed, k]).generate_state(1, np.uint64)[0])


def resident_memory(process: int) -> float:
    """Resident memory of a process [GB], from /proc; 0 if it has ended."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (FileNotFoundError, ProcessLookupError):
        return 0.0


def _worker_main(connection: Connection, job: Job) -> None:
    """The main function of a worker process; errors that do not belong to one entry end it and the job."""
    threading.Thread(target=_exit_with_parent, args=(os.getppid(),), daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which lets a collision finish
    disable_progress()  # the parent shows the progress of all workers
    try:
        storage = open_storage(job.location)
        if read_manifest(storage) is None:
            here = socket.gethostname()
            raise BadInput(f"{job.location}: no {MANIFEST} is visible from {here}; share the folder, or use s3://")
        simulator = job.make_simulator(job.settings)
        connection.send(None)
        with open(os.devnull, "w") as nowhere:
            while True:
                entry = connection.recv()
                if math.isfinite(job.limit):  # a timer in C: a kernel that hangs blocks every Python thread
                    faulthandler.dump_traceback_later(job.limit + GRACE_PERIOD, exit=True, file=nowhere)
                _simulate_entry(storage, job.settings, simulator, entry)
                faulthandler.cancel_dump_traceback_later()
                connection.send(None)
    except EOFError:
        return  # the parent has closed the connection
    except (BadInput, NoSolution) as problem:
        connection.send(type(problem)(str(problem)))
    except Exception as error:
        connection.send(RuntimeError(f"a worker failed: {error}\n{traceback.format_exc()}"))


def _exit_with_parent(parent: int) -> None:
    """End this process when the parent has been killed: nobody would collect its results."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _simulate_entry(storage: Storage, settings: DatasetSettings, simulator: Simulator, entry: int) -> None:
    """Simulate and store one entry; an error in the simulation is stored as its result."""
    if storage.read(record_key(entry), MAX_JSON_BYTES) is not None:
        return  # stored by another process
    k, repeat = divmod(entry, settings.repeats)
    seed = collision_seed(settings.seed, k)
    rng = np.random.default_rng(seed)
    try:
        result = simulator(rng, None if repeat == 0 else np.random.default_rng([seed, repeat]))
        objects = None if result.pattern is None else encode_pattern(result.pattern)
    except Exception as problem:
        known = isinstance(problem, BadInput | NoSolution)
        reason = str(problem) if known else f"{type(problem).__name__}: {problem}"
        log.warning("%s: entry %d failed: %s", storage.location, entry, reason, exc_info=not known)
        write_failed(storage, entry, reason, seed)
        return
    if result.impact is None or result.pattern is None:
        write_unbroken(storage, entry, result.impact, seed)
    else:
        write_entry(storage, Record(entry, "broken", seed, result.impact, result.pattern.count), objects)
