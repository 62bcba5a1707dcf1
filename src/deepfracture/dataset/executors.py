"""Where the entries of a job are simulated: in processes of this machine, or on a Ray cluster."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import islice
from queue import SimpleQueue
from typing import Any, Protocol

from deepfracture.dataset.entries import write_failed
from deepfracture.dataset.watchdog import Job, WatchedWorker, collision_seed
from deepfracture.runtime.extras import require
from deepfracture.runtime.progress import log
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput

EXECUTORS = ("local", "ray")
MAX_RETRIES = 10
"""Retries of an entry whose machine was lost."""
MAX_PENDING = 1000
"""Tasks submitted to a cluster at once."""


class Executor(Protocol):
    """Simulates entries in any order; yields the number of each once it is stored."""

    def run(self, job: Job, entries: Sequence[int]) -> Iterator[int]: ...


def make_executor(name: str, *, workers: int | None, address: str | None) -> Executor:
    """The executor called `name`.

    Args:
        name: One of `EXECUTORS`.
        workers: Concurrent entries; by default two on this machine, and all processors of a cluster.
        address: Of the Ray cluster; by default the one that this machine belongs to.

    Raises:
        BadInput: There is no such executor, or a value makes no sense for it."""
    if name not in EXECUTORS:
        raise BadInput(f"executor must be one of {', '.join(EXECUTORS)}, got {name!r}{did_you_mean(name, EXECUTORS)}")
    if workers is not None and workers < 1:
        raise BadInput(f"workers must be at least 1, got {workers}")
    if name == "ray":
        return RayCluster(address or "auto", workers)
    if address is not None:
        raise BadInput(f"address {address}: only with executor ray")
    return Local(workers or 2)


@dataclass(frozen=True)
class Local:
    """Processes of this machine."""

    workers: int

    def run(self, job: Job, entries: Sequence[int]) -> Iterator[int]:
        workers = [WatchedWorker(job) for _ in range(min(self.workers, len(entries)))]
        idle: SimpleQueue[WatchedWorker] = SimpleQueue()
        for worker in workers:
            idle.put(worker)

        def simulate(entry: int) -> int:
            worker = idle.get()
            try:
                worker(entry)
            finally:
                idle.put(worker)
            return entry

        with ThreadPoolExecutor(len(workers)) as threads:
            futures = [threads.submit(simulate, entry) for entry in entries]
            try:
                for future in as_completed(futures):
                    yield future.result()
            finally:  # on an error or Ctrl-C drop what has not started; running entries are still stored
                threads.shutdown(wait=True, cancel_futures=True)
                for worker in workers:
                    worker.close()


@dataclass(frozen=True)
class RayCluster:
    """Tasks on a Ray cluster, one processor each. Ray places them and retries those of lost machines; the workers write
    into the shared folder or bucket themselves."""

    address: str
    workers: int | None
    """Concurrent tasks; None: as many as the cluster has processors at any time."""

    def run(self, job: Job, entries: Sequence[int]) -> Iterator[int]:
        ray = require("ray", extra="ray", to="simulate on many machines")
        connect = not ray.is_initialized()
        if connect:
            try:
                ray.init(self.address, log_to_driver=False, logging_level=logging.WARNING)
            except ConnectionError as error:
                reason = str(error).split("\n")[0]
                raise BadInput(
                    f"address {self.address}: no Ray cluster there ({reason}); start one with ray start --head"
                ) from error
        try:
            yield from self._run(ray, job, entries)
        finally:
            if connect:
                ray.shutdown()

    def _run(self, ray: Any, job: Job, entries: Sequence[int]) -> Iterator[int]:
        simulate = ray.remote(num_cpus=1, max_retries=MAX_RETRIES)(_ray_task)
        shared = ray.put(job)
        remaining, tasks = iter(entries), {}
        while True:
            for entry in islice(remaining, min(self.workers or MAX_PENDING, MAX_PENDING) - len(tasks)):
                tasks[simulate.remote(shared, entry)] = entry
            if not tasks:
                return
            for task in ray.wait(list(tasks))[0]:
                entry = tasks.pop(task)
                _collect(ray, task, job, entry)
                yield entry


def _collect(ray: Any, task: Any, job: Job, entry: int) -> None:
    """Check that a finished task has stored its entry; one that loses machine after machine is stored as failed."""
    try:
        ray.get(task)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, ray.exceptions.RaySystemError):
            reason = str(error.cause).splitlines()[0]
            raise BadInput(
                f"a machine of the cluster cannot run this ({reason}); install the same versions on all machines"
            ) from None
        raise error.cause from None  # raised by our own code in the task
    except (
        ray.exceptions.WorkerCrashedError,
        ray.exceptions.OutOfMemoryError,
        ray.exceptions.NodeDiedError,
        ray.exceptions.LocalRayletDiedError,
    ) as error:
        reason = f"{MAX_RETRIES + 1} workers were lost over it: {str(error).splitlines()[0]}"
        log.warning("%s: entry %d failed: %s", job.location, entry, reason)
        settings = job.settings
        write_failed(job.location, entry, reason, collision_seed(settings.seed, entry // settings.repeats))


_worker: WatchedWorker | None = None
"""The worker of this Ray process, which runs one task at a time."""


def _ray_task(job: Job, entry: int) -> None:
    """A task: the Ray process watches a worker of ours, as `Local` does."""
    global _worker
    if _worker is None or _worker.job.name != job.name:
        if _worker is not None:
            _worker.close()
        _worker = WatchedWorker(job)
    _worker(entry)
