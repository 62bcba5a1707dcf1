"""Work shared by all cores: compiled kernels that let go of the interpreter's lock (`nogil`), each on its own part."""

from __future__ import annotations

import heapq
import itertools
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np

from deepfracture.types import Floats32

T = TypeVar("T")
S = TypeVar("S")

PARTS = 3
"""Parts for each thread: who is done early, or is not held up by other programs, takes more of them."""

UNEVEN = 12
"""The same, where nobody knows how long a part takes."""

BLOCK = 2048
"""Rows of a block of `product`."""

ONE_THREAD: Mapping[str, str] = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
"""What a process reads when it starts."""

LINGER = 2_000_000
"""Turns of a loop, about a millisecond, for which a thread stays awake to wait for another."""

_busy = threading.local()
_starting = threading.Lock()


@contextmanager
def single_threaded_processes() -> Iterator[None]:
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


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Products of matrices on the calling thread: OpenBLAS's own threads stay awake for 20 ms after each, and whatever
    shares its work next goes at half its speed."""
    with _blas().limit(limits=1, user_api="blas"):
        yield


@cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def parallel_matmul(rows: Floats32, matrix: Floats32) -> Floats32:
    """rows @ matrix, blocks of rows side by side: the same for any number of threads."""
    found = np.empty((len(rows), matrix.shape[1]), np.float32)

    def blocks(first: int, last: int) -> None:
        for n in range(first, last):
            block = slice(n * BLOCK, (n + 1) * BLOCK)
            np.matmul(rows[block], matrix, out=found[block])

    with single_threaded_blas():
        parallel_for(blocks, -(-len(rows) // BLOCK), least=1)
    return found


def thread_count() -> int:
    """Threads that kernels may use: NUMBA_NUM_THREADS, or else the cores of this process."""
    from numba import config

    return int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


def parallel_for(job: Callable[[int, int], T], count: int, *, least: int, uneven: bool = False) -> list[T]:
    """`job(first, last)` of consecutive parts of range(count), side by side; the results in their order.

    What comes out must not depend on the parts. Below 2 `least` it is one part, done at once; so it is inside another
    shared work. Where some parts take much longer than others (`uneven`) there are more of them."""
    threads = thread_count()
    parts = min((UNEVEN if uneven else PARTS) * threads, count // least)
    if parts < 2 or threads < 2 or getattr(_busy, "here", False):
        return [job(0, count)]
    return _shared([_part(job, count * n // parts, count * (n + 1) // parts) for n in range(parts)], threads)


def parallel_map(job: Callable[[int], T], sizes: Sequence[float]) -> list[T]:
    """`job(n)` for each n of range(len(sizes)), side by side; the results in their order.

    `sizes` say how much work each is: they are put into groups of about the same size, the largest first."""
    threads = thread_count()
    parts = min(PARTS * threads, len(sizes))
    if parts < 2 or threads < 2 or getattr(_busy, "here", False):
        return [job(n) for n in range(len(sizes))]
    groups: list[tuple[float, list[int]]] = [(0.0, []) for _ in range(parts)]
    for n in sorted(range(len(sizes)), key=lambda n: -sizes[n]):
        total, group = heapq.heappop(groups)  # the least so far; one with the same total that has fewer comes first
        heapq.heappush(groups, (total + sizes[n], [*group, n]))
    found: list[Any] = [None] * len(sizes)

    def each(group: list[int]) -> None:
        for n in group:
            found[n] = job(n)

    _shared([partial(each, group) for _, group in sorted(groups, reverse=True)], threads)
    return found


def parallel_invoke(one: Callable[[], T], other: Callable[[], S]) -> tuple[T, S]:
    """The results of two jobs, done side by side."""
    if thread_count() < 2 or getattr(_busy, "here", False):
        return one(), other()
    jobs: list[Callable[[], Any]] = [one, other]
    first, second = _shared(jobs, 2)
    return first, second


def _part(job: Callable[[int, int], T], first: int, last: int) -> Callable[[], T]:
    return lambda: job(first, last)


def _shared(jobs: list[Callable[[], T]], threads: int) -> list[T]:
    work = _Work(jobs)
    lingering = _lingering(os.getpid())
    for _ in range(threads - 1):
        try:
            helper = lingering.pop()
        except IndexError:
            _pool(os.getpid(), threads).submit(_help, work)
        else:
            helper.work = work
            helper.called[0] = 1
    work.share()
    work.wait()
    if work.failure is not None:
        raise work.failure
    return work.done


class _Work:
    """Jobs, and what has come of them. A helper that has not come to start is not waited for."""

    def __init__(self, jobs: list[Callable[[], Any]]) -> None:
        self.jobs = jobs
        self.done: list[Any] = [None] * len(jobs)
        self.failure: BaseException | None = None
        self._left = np.ones(len(jobs), np.int64)
        self._turn = itertools.count()
        self._ended = threading.Event()

    def share(self) -> None:
        """Do jobs until none is left that nobody does. After a failure the others are dropped."""
        _busy.here = True
        while (n := next(self._turn)) < len(self.jobs):
            try:
                if self.failure is None:
                    self.done[n] = self.jobs[n]()
            except BaseException as problem:  # told by the thread that waits for the jobs
                self.failure = problem
            self._left[n] = 0
        _busy.here = False
        if not self._left.any():
            self._ended.set()

    def wait(self) -> None:
        """Until the jobs that others do are done."""
        from deepfracture.runtime.spin import spin_until_zero

        if not spin_until_zero(self._left, LINGER):
            self._ended.wait()


class _Helper:
    """A thread that has helped and stays awake for a moment, as more to do often comes soon."""

    def __init__(self) -> None:
        self.called = np.zeros(1, np.int64)
        self.work: _Work | None = None


def _help(work: _Work) -> None:
    """What a thread of the pool does."""
    from deepfracture.runtime.spin import spin_until

    me, lingering = _Helper(), _lingering(os.getpid())
    while True:
        work.share()
        me.called[0] = 0
        lingering.append(me)
        if not spin_until(me.called, 1, LINGER):
            try:
                lingering.remove(me)
            except ValueError:  # just taken from there: the call comes at once
                while not spin_until(me.called, 1, LINGER):
                    pass
            else:
                return
        assert me.work is not None
        work = me.work


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """The threads of a process; a fork has none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="deepfracture")


@cache
def _lingering(process: int) -> list[_Helper]:
    """Helpers of a process that are awake and have nothing to do."""
    return []
