"""Work shared by all cores: compiled kernels that let go of the interpreter's lock (`nogil`), each on its own part."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

T = TypeVar("T")

PARTS = 3
"""Parts for each thread: who is done early, or is not held up by other programs, takes more of them."""

ONE_THREAD: Mapping[str, str] = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
"""What a process reads when it starts."""

_busy = threading.local()
_starting = threading.Lock()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes that start meanwhile use one thread: quickest where there are many, and sums always come out alike."""
    with _starting:
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


def thread_count() -> int:
    """Threads that kernels may use: NUMBA_NUM_THREADS, or else the cores of this process."""
    from numba import config

    return int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


def spread(job: Callable[[int, int], T], count: int, *, least: int) -> list[T]:
    """`job(first, last)` of consecutive parts of range(count), side by side; the results in their order.

    What comes out must not depend on the parts. Below 2 `least` it is one part, done at once; so it is inside another
    shared work."""
    threads = thread_count()
    parts = min(PARTS * threads, count // least)
    if parts < 2 or threads < 2 or getattr(_busy, "here", False):
        return [job(0, count)]
    return _shared([_part(job, count * n // parts, count * (n + 1) // parts) for n in range(parts)], threads)


def together(one: Callable[[], T], other: Callable[[], T]) -> tuple[T, T]:
    """The results of two jobs, done side by side."""
    if thread_count() < 2 or getattr(_busy, "here", False):
        return one(), other()
    first, second = _shared([one, other], 2)
    return first, second


def _part(job: Callable[[int, int], T], first: int, last: int) -> Callable[[], T]:
    return lambda: job(first, last)


def _shared(jobs: list[Callable[[], T]], threads: int) -> list[T]:
    done: list = [None] * len(jobs)
    turn = itertools.count()

    def work() -> None:
        _busy.here = True
        try:
            while (n := next(turn)) < len(jobs):
                done[n] = jobs[n]()
        finally:
            _busy.here = False

    helpers = [_pool(os.getpid(), threads).submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        # A helper that has not come to start is not waited for: its parts are done.
        failures = [helper.exception() for helper in helpers if not helper.cancel()]
    for failure in failures:
        if failure is not None:
            raise failure
    return done


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """The threads of a process; a fork has none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="deepfracture")
