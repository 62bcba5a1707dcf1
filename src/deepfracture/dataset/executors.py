"""Who does the entries of a job: processes of this machine, or the machines of a Ray cluster."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import islice
from queue import SimpleQueue
from typing import Any, Protocol

from deepfracture.dataset.guard import Guarded, Job, collision_seed
from deepfracture.dataset.store import write_failed
from deepfracture.runtime.extras import require
from deepfracture.runtime.progress import log
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput

EXECUTORS = ("local", "ray")
LOSSES = 10
"""Times that an entry is begun anew after the machine that did it was lost."""
WAITING = 1000
"""Tasks that a cluster is told of at once."""


class Executor(Protocol):
    """Does entries in any order; every one is stored when its number is given back."""

    def run(self, job: Job, entries: Sequence[int]) -> Iterator[int]: ...


def executor_named(name: str, *, workers: int | None, address: str | None) -> Executor:
    """The executor that a person means.

    Args:
        name: One of `EXECUTORS`.
        workers: Entries at once; by default two here, and as many as a cluster has processors.
        address: Of the Ray cluster; by default the one that this machine belongs to.

    Raises:
        BadInput: There is no such executor, or a value makes no sense for it."""
    if name not in EXECUTORS:
        raise BadInput(f"executor must be one of {', '.join(EXECUTORS)}, got {name!r}{did_you_mean(name, EXECUTORS)}")
    if workers is not None and workers < 1:
        raise BadInput(f"workers must be at least 1, got {workers}")
    if name == "ray":
        return OnRay(address or "auto", workers)
    if address is not None:
        raise BadInput(f"address {address}: only with executor ray")
    return Local(workers or 2)


@dataclass(frozen=True)
class Local:
    """Processes of this machine."""

    workers: int

    def run(self, job: Job, entries: Sequence[int]) -> Iterator[int]:
        guards = [Guarded(job) for _ in range(min(self.workers, len(entries)))]
        idle: SimpleQueue[Guarded] = SimpleQueue()
        for guard in guards:
            idle.put(guard)

        def do(entry: int) -> int:
            guard = idle.get()
            try:
                guard(entry)
            finally:
                idle.put(guard)
            return entry

        with ThreadPoolExecutor(len(guards)) as threads:
            futures = [threads.submit(do, entry) for entry in entries]
            try:
                for future in as_completed(futures):
                    yield future.result()
            finally:  # on an error or Ctrl-C drop what has not started; what runs is still stored
                threads.shutdown(wait=True, cancel_futures=True)
                for guard in guards:
                    guard.close()


@dataclass(frozen=True)
class OnRay:
    """Tasks on a Ray cluster, one processor each. Ray says where, and begins anew what a lost machine had begun;
    the workers write into the shared folder or bucket themselves."""

    address: str
    workers: int | None
    """Tasks at once; None: as many as there are processors, whoever joins."""

    def run(self, job: Job, entries: Sequence[int]) -> Iterator[int]:
        ray = require("ray", extra="ray", to="simulate on many machines")
        ours = not ray.is_initialized()
        if ours:
            try:
                ray.init(self.address, log_to_driver=False, logging_level=logging.WARNING)
            except ConnectionError as error:
                reason = str(error).split("\n")[0]
                raise BadInput(
                    f"address {self.address}: no Ray cluster there ({reason}); begin one with ray start --head"
                ) from error
        try:
            yield from self._run(ray, job, entries)
        finally:
            if ours:
                ray.shutdown()

    def _run(self, ray: Any, job: Job, entries: Sequence[int]) -> Iterator[int]:
        do = ray.remote(num_cpus=1, max_retries=LOSSES)(_on_a_node)
        shared = ray.put(job)
        left, tasks = iter(entries), {}
        while True:
            for entry in islice(left, min(self.workers or WAITING, WAITING) - len(tasks)):
                tasks[do.remote(shared, entry)] = entry
            if not tasks:
                return
            for task in ray.wait(list(tasks))[0]:
                entry = tasks.pop(task)
                _settle(ray, task, job, entry)
                yield entry


def _settle(ray: Any, task: Any, job: Job, entry: int) -> None:
    """See that a finished task has stored its entry; one that costs machine after machine has failed."""
    try:
        ray.get(task)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, ray.exceptions.RaySystemError):
            reason = str(error.cause).splitlines()[0]
            raise BadInput(f"a machine of the cluster cannot run this ({reason}); install the same as here") from None
        raise error.cause from None  # by our own code there
    except (
        ray.exceptions.WorkerCrashedError,
        ray.exceptions.OutOfMemoryError,
        ray.exceptions.NodeDiedError,
        ray.exceptions.LocalRayletDiedError,
    ) as error:
        reason = f"{LOSSES + 1} workers were lost over it: {str(error).splitlines()[0]}"
        log.warning("%s: entry %d passed over: %s", job.place, entry, reason)
        settings = job.settings
        write_failed(job.place, entry, reason, collision_seed(settings.seed, entry // settings.repeats))


_guard: Guarded | None = None
"""Of this worker process of Ray, which does one task at a time."""


def _on_a_node(job: Job, entry: int) -> None:
    """A task: Ray's process watches over one of ours, as `Local` does."""
    global _guard
    if _guard is None or _guard.job.name != job.name:
        if _guard is not None:
            _guard.close()
        _guard = Guarded(job)
    _guard(entry)
