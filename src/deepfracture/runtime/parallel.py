"""Work shared by threads: compiled kernels that release the interpreter lock (`nogil`), each on its own part."""

from __future__ import annotations

import heapq
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np

from deepfracture.types import Floats32

T = TypeVar("T")
S = TypeVar("S")

PARTS = 3
"""Parts per thread: threads that finish early, or that other programs do not hold up, take more of them."""

UNEVEN_PARTS = 12
"""Parts per thread where the cost of a part is unknown."""

BLOCK = 2048
"""Rows of a block of `parallel_matmul`."""

ONE_THREAD: Mapping[str, str] = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
"""Environment variables that a process reads at its start."""

_worker = threading.local()
_environment = threading.Lock()


@contextmanager
def single_threaded_processes() -> Iterator[None]:
    """Processes started in this block use one thread: fastest with many processes, and sums are reproducible."""
    with _environment:
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        os.environ.update(ONE_THREAD)
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Matrix products on the calling thread: OpenBLAS's own threads spin for 20 ms after each one, which halves the
    speed of any parallel work that follows."""
    with _blas().limit(limits=1, user_api="blas"):
        yield


@cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def parallel_matmul(rows: Floats32, matrix: Floats32) -> Floats32:
    """`rows @ matrix`, blocks of rows in parallel: the same bytes for any number of threads."""
    product = np.empty((len(rows), matrix.shape[1]), np.float32)

    def multiply(first: int, last: int) -> None:
        for n in range(first, last):
            block = slice(n * BLOCK, (n + 1) * BLOCK)
            np.matmul(rows[block], matrix, out=product[block])

    with single_threaded_blas():
        parallel_for(multiply, -(-len(rows) // BLOCK), least=1)
    return product


def thread_count() -> int:
    """Threads that kernels may use: NUMBA_NUM_THREADS, by default the cores available to this process."""
    from numba import config

    return int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


def parallel_for(job: Callable[[int, int], T], count: int, *, least: int, uneven: bool = False) -> list[T]:
    """`job(first, last)` on consecutive parts of range(count) in parallel; the results in order.

    The concatenated results must not depend on the parts. Below 2 `least` items there is a single part, run by the
    caller; so it is inside other parallel work. `uneven`: more and smaller parts, as some take much longer."""
    threads = thread_count()
    parts = min((UNEVEN_PARTS if uneven else PARTS) * threads, count // least)
    if parts < 2 or threads < 2 or _inside():
        return [job(0, count)]
    return _run([partial(job, count * n // parts, count * (n + 1) // parts) for n in range(parts)], threads)


def parallel_map(job: Callable[[int], T], sizes: Sequence[float]) -> list[T]:
    """`job(n)` for each n of range(len(sizes)) in parallel; the results in order.

    `sizes`: relative cost of each job. Jobs are packed into groups of similar cost, the largest first (longest
    processing time rule, Graham 1969)."""
    threads = thread_count()
    parts = min(PARTS * threads, len(sizes))
    if parts < 2 or threads < 2 or _inside():
        return [job(n) for n in range(len(sizes))]
    groups: list[tuple[float, list[int]]] = [(0.0, []) for _ in range(parts)]
    for n in sorted(range(len(sizes)), key=lambda n: -sizes[n]):
        total, group = heapq.heappop(groups)  # the cheapest; among equals the one of fewer jobs
        heapq.heappush(groups, (total + sizes[n], [*group, n]))
    results: list[Any] = [None] * len(sizes)

    def run_group(group: list[int]) -> None:
        for n in group:
            results[n] = job(n)

    _run([partial(run_group, group) for _, group in sorted(groups, reverse=True)], threads)
    return results


def parallel_invoke(one: Callable[[], T], other: Callable[[], S]) -> tuple[T, S]:
    """The results of two jobs that run in parallel."""
    if thread_count() < 2 or _inside():
        return one(), other()
    jobs: list[Callable[[], Any]] = [one, other]
    first, second = _run(jobs, 2)
    return first, second


def _inside() -> bool:
    """Whether this thread is running a part of parallel work."""
    return getattr(_worker, "active", False)


def _run(jobs: list[Callable[[], T]], threads: int) -> list[T]:
    """Run the jobs on the calling thread and on helpers from the pool: each takes the next job until none is left.

    Helpers that have not started by then are cancelled, so a busy machine is not waited for."""
    results: list[Any] = [None] * len(jobs)
    left = iter(range(len(jobs)))  # shared: `next` is atomic

    def work() -> None:
        _worker.active = True
        try:
            for n in left:
                results[n] = jobs[n]()
        finally:
            deque(left, maxlen=0)  # after a failure the rest is dropped
            _worker.active = False

    helpers = [_pool(os.getpid(), threads).submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        started = [helper for helper in helpers if not helper.cancel()]
        wait(started)
    for helper in started:
        helper.result()  # raises its failure
    return results


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """The threads of a process: a fork inherits none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="deepfracture")
