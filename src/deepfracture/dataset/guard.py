"""A worker process that is watched: what hangs, takes too much memory or dies costs one entry, never the job."""

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

from deepfracture.dataset.arrays import shards
from deepfracture.dataset.record import LARGEST, Record, record_key
from deepfracture.dataset.storage import Storage, storage_at
from deepfracture.dataset.store import MANIFEST, Settings, put, read_manifest, write_failed, write_unbroken
from deepfracture.runtime.parallel import single_threaded_processes
from deepfracture.runtime.progress import disable_progress, log
from deepfracture.types import BadInput, FracturePattern, Impact, NoSolution

ATTEMPTS = 2
"""Times that an entry is tried whose worker dies: it may have been somebody else's doing."""
GLANCE = 0.2
"""Seconds between two looks at the memory of a worker."""
GRACE = 30.0
"""Seconds beyond the limit after which a worker whose watcher is gone ends itself."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one collision did."""

    impact: Impact | None
    """None: the ball missed."""
    pattern: FracturePattern | None
    """None: nothing broke."""


Collide: TypeAlias = Callable[[np.random.Generator, np.random.Generator | None], Outcome]
"""One random collision, a function of the generators alone: the first draws the scene, the second, or what the
scene has left of the first, the material."""


@dataclass(frozen=True, eq=False)
class Job:
    """All that a worker needs to simulate any entry, on any machine that reaches `place`."""

    name: str
    """No other job has it."""
    place: str
    """Folder or s3:// address of the data set."""
    settings: Settings
    prepare: Callable[[Settings], Collide]
    limit: float
    """Seconds that a collision may take."""
    memory: float
    """Gigabytes that a worker may take; infinite: it is not watched."""


class Guarded:
    """One process that does the entries of a job, one after another, and is started anew whenever it is lost."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._process: Any = None
        self._line: Connection | None = None

    def __call__(self, entry: int) -> None:
        """Do one entry: when this returns it is stored, at worst as one that failed.

        Raises:
            BadInput: The data set cannot be written, or the job makes no sense.
            NoSolution: The shape cannot be prepared within the limits.
            RuntimeError: The program is at fault."""
        for attempt in range(ATTEMPTS):
            if self._process is None:
                self._start()
            assert self._line is not None
            with suppress(OSError):  # it has died: the answer will say so
                self._line.send(entry)
            reason = self._answer()
            if reason is None:
                return
            if reason.startswith("the worker"):
                log.info("%s: entry %d: %s, attempt %d of %d", self.job.place, entry, reason, attempt + 1, ATTEMPTS)
                continue
            break
        log.warning("%s: entry %d passed over: %s", self.job.place, entry, reason)
        settings = self.job.settings
        write_failed(self.job.place, entry, reason, collision_seed(settings.seed, entry // settings.repeats))

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            assert self._line is not None
            self._line.close()
            self._process.kill()
            self._process.join()
            self._process = None

    def _start(self) -> None:
        context = get_context("spawn")
        self._line, theirs = context.Pipe()
        with single_threaded_processes():
            self._process = context.Process(target=_work, args=(theirs, self.job), daemon=True)
            self._process.start()
        theirs.close()
        reason = self._answer()
        if reason is not None:
            raise NoSolution(f"{self.job.place}: {self.job.settings.shape.name} cannot be prepared: {reason}")

    def _answer(self) -> str | None:
        """None when the process has done what it was told, else what became of it; then it is no more."""
        job, process, line = self.job, self._process, self._line
        assert line is not None
        deadline = time.monotonic() + job.limit
        while True:
            glance = GLANCE if math.isfinite(job.memory) else math.inf
            left = deadline - time.monotonic()
            ready = wait([line, process.sentinel], None if math.isinf(min(left, glance)) else max(min(left, glance), 0))
            if line in ready:
                try:
                    told = line.recv()
                except (EOFError, OSError):
                    ready = [process.sentinel]
                else:
                    if told is not None:
                        self.close()
                        raise told
                    return None
            reason = ""
            if process.sentinel in ready:
                process.join()
                reason = f"the worker died (exit status {process.exitcode}), perhaps for lack of memory"
            elif time.monotonic() >= deadline:
                reason = f"took longer than {job.limit:g} s"
            elif resident(process.pid) > job.memory:
                reason = f"took more than {job.memory:g} GB"
            if reason:
                self.close()
                return reason


def collision_seed(seed: int, k: int) -> int:
    """The seed of collision `k`: independent streams however close the numbers are."""
    return int(np.random.SeedSequence([seed, k]).generate_state(1, np.uint64)[0])


def resident(process: int) -> float:
    """Memory that a process takes [GB], as Linux tells; 0 when it is no more."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (FileNotFoundError, ProcessLookupError):
        return 0.0


def _work(line: Connection, job: Job) -> None:
    """The life of a worker process: what cannot be blamed on one entry ends it and the job."""
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent: let a collision finish
    disable_progress()  # the parent shows how far all of them are
    try:
        storage = storage_at(job.place)
        if read_manifest(storage) is None:
            here = socket.gethostname()
            raise BadInput(f"{job.place}: no {MANIFEST} is seen from {here}; share the folder, or use s3://")
        collide = job.prepare(job.settings)
        line.send(None)
        with open(os.devnull, "w") as nowhere:
            while True:
                entry = line.recv()
                if math.isfinite(job.limit):  # by the clock alone: a kernel that hangs lets no thread of Python run
                    faulthandler.dump_traceback_later(job.limit + GRACE, exit=True, file=nowhere)
                _collide(storage, job.settings, collide, entry)
                faulthandler.cancel_dump_traceback_later()
                line.send(None)
    except EOFError:
        return  # the parent needs no more
    except (BadInput, NoSolution) as problem:
        line.send(type(problem)(str(problem)))
    except Exception as error:
        line.send(RuntimeError(f"a worker failed: {error}\n{traceback.format_exc()}"))


def _leave_with(parent: int) -> None:
    """End this process when the parent has been killed: nobody would collect what it does."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _collide(storage: Storage, settings: Settings, collide: Collide, entry: int) -> None:
    """Simulate and store one entry; what this one collision cannot do the others need not suffer for."""
    if storage.read(record_key(entry), LARGEST) is not None:
        return  # another writer has done it meanwhile
    k, repeat = divmod(entry, settings.repeats)
    seed = collision_seed(settings.seed, k)
    rng = np.random.default_rng(seed)
    try:
        outcome = collide(rng, None if repeat == 0 else np.random.default_rng([seed, repeat]))
        objects = None if outcome.pattern is None else shards(outcome.pattern)
    except Exception as problem:
        known = isinstance(problem, BadInput | NoSolution)
        reason = str(problem) if known else f"{type(problem).__name__}: {problem}"
        log.warning("%s: entry %d passed over: %s", storage.place, entry, reason, exc_info=not known)
        write_failed(storage, entry, reason, seed)
        return
    if outcome.impact is None or outcome.pattern is None:
        write_unbroken(storage, entry, outcome.impact, seed)
    else:
        put(storage, Record(entry, "broken", seed, outcome.impact, outcome.pattern.count), objects)
