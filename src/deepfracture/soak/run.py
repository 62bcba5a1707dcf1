"""Hits in worker processes: one that hangs or dies costs its hit alone."""

from __future__ import annotations

import faulthandler
import os
import queue
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from deepfracture.runtime.parallel import single_threaded_processes
from deepfracture.runtime.progress import disable_progress, log, track
from deepfracture.soak.hit import ShapesAndBreakers, check, hit, play, prepare
from deepfracture.soak.plan import Case, SoakOptions, first_cases
from deepfracture.soak.results import Results, Row
from deepfracture.types import BadInput

if TYPE_CHECKING:
    from multiprocessing.context import SpawnProcess

PREPARE_LIMIT = 600.0
"""Longest time for preparing a shape and a breaker, and for the checks [s]; not part of the hit."""
STACK_LINES = 30
"""Lines kept of the stack of a hanging process."""


def soak(
    options: SoakOptions, hits: int, *, out: Path | None = None, workers: int = 1, limit: float = 120.0
) -> list[Row]:
    """The rows of hits 0 .. `hits` - 1; those stored in the folder `out` are not repeated.

    Args:
        out: Folder where each row is stored as soon as it is known; None: not stored.
        workers: Number of processes.
        limit: Longest time for a hit [s]; a slower one fails.

    Raises:
        BadInput: A value is out of range, a shape cannot be used, or `out` holds a soak of other options.
    """
    if hits < 1 or workers < 1:
        raise BadInput(f"hits and workers must be at least 1, got {hits} and {workers}")
    if not limit > 0:
        raise BadInput(f"limit must be positive, got {limit}")
    cases = list(first_cases(options, hits))
    with Results(options, out) as results:
        done = results.done
        missing = [one for one in cases if one.number not in done]
        for row in track(_rows(options, missing, min(workers, len(missing)), limit), name="hits", total=len(missing)):
            results.add(row)
            if row["failures"]:
                one = cases[row["number"]]
                log.warning("%s %s: repeat it with %s", _kinds(row), row.get("detail", ""), one.command(options))
        return [row for row in results.rows if row["number"] < hits]


def _kinds(row: Row) -> str:
    return ", ".join(row["failures"])


def _rows(options: SoakOptions, cases: list[Case], workers: int, limit: float) -> Iterator[Row]:
    """The row of each case, as they are completed."""
    waiting: queue.SimpleQueue[Case] = queue.SimpleQueue()
    for one in cases:
        waiting.put(one)
    found: queue.SimpleQueue[Row | BaseException] = queue.SimpleQueue()
    stopped = threading.Event()
    with single_threaded_processes():
        processes = [_Worker(options, limit, waiting, found, stopped) for _ in range(workers)]
        try:
            for _ in cases:
                row = found.get()
                if isinstance(row, BaseException):
                    raise row
                yield row
        finally:
            stopped.set()
            for process in processes:
                process.close()


class _Worker:
    """A worker process and the thread that feeds it cases; the process is restarted after a kill."""

    def __init__(
        self,
        options: SoakOptions,
        limit: float,
        waiting: queue.SimpleQueue[Case],
        found: queue.SimpleQueue[Row | BaseException],
        stopped: threading.Event,
    ) -> None:
        self._options, self._limit = options, limit
        self._waiting, self._found, self._stopped = waiting, found, stopped
        self._process: SpawnProcess | None = None
        self._stack = Path(tempfile.mkstemp(prefix="deepfracture-soak-", suffix=".stack")[1])
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the process and wait for the thread."""
        self._kill()
        self._thread.join()
        self._kill()
        self._stack.unlink(missing_ok=True)

    def _run(self) -> None:
        try:
            while not self._stopped.is_set():
                try:
                    one = self._waiting.get_nowait()
                except queue.Empty:
                    return
                row = self._one(one)
                if not self._stopped.is_set():
                    self._found.put(row)
        except BaseException as problem:  # raised by the main thread, which waits for a row
            self._found.put(problem)

    def _one(self, one: Case) -> Row:
        process = self._process or self._start()
        began = time.perf_counter()
        row: Row = {**asdict(one), "worker": process.pid}
        try:
            self._pipe.send(one)
            for patience in (PREPARE_LIMIT, self._limit, PREPARE_LIMIT):
                began = time.perf_counter()
                if not self._pipe.poll(patience):
                    return row | self._ended("limit", f"more than {patience:g} s", began)
                said = self._pipe.recv()
                if said is not None:
                    return row | said
        except (EOFError, OSError):
            process.join(5.0)
            return row | self._ended("died", _reason(process.exitcode), began)
        raise AssertionError("a worker says no more than that")

    def _ended(self, kind: str, detail: str, began: float) -> Row:
        """The result of a hit whose process is killed or dead."""
        self._kill()
        stack = self._stack.read_text(errors="replace").splitlines()[:STACK_LINES]
        found = {"failures": {kind: 1}, "detail": detail, "seconds": time.perf_counter() - began}
        return found | ({"traceback": "\n".join(stack)} if stack else {})

    def _start(self) -> SpawnProcess:
        context = get_context("spawn")
        self._stack.write_text("")
        self._pipe, theirs = context.Pipe()
        process = context.Process(
            target=_work, args=(theirs, self._options, self._limit, str(self._stack)), daemon=True
        )
        process.start()
        theirs.close()
        self._process = process
        return process

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.join()


def _reason(code: int | None) -> str:
    if code is None or code >= 0:
        return f"the process ended with status {code}"
    with suppress(ValueError):
        return f"the process was killed by {signal.Signals(-code).name}"
    return f"the process was killed by signal {-code}"


def _work(pipe: Connection, options: SoakOptions, limit: float, stack: str) -> None:
    """Main loop of a worker: sends None when a case is prepared, None when it is simulated, then its row."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl+C and ends this process
    threading.Thread(target=_exit_with, args=(os.getppid(),), daemon=True).start()
    disable_progress()
    log.setLevel("ERROR")
    resources, known = ShapesAndBreakers(options), set()
    with open(stack, "w", encoding="utf-8") as file:
        faulthandler.enable(file)
        while True:
            one = pipe.recv()
            try:
                ready = prepare(resources, one)
                if one.breaker not in known:
                    hit(prepare(resources, one))  # compiles kernels, which is not part of the hit
                    known.add(one.breaker)
            except Exception as problem:  # of this case alone
                pipe.send(
                    {"failures": {"prepare": 1}, "detail": f"{type(problem).__name__}: {problem}", "seconds": 0.0}
                )
                continue
            pipe.send(None)
            faulthandler.dump_traceback_later(0.8 * limit, file=file)
            played = play(ready)
            faulthandler.cancel_dump_traceback_later()
            pipe.send(None)
            pipe.send(check(played))


def _exit_with(parent: int) -> None:
    """End this process when the parent is killed."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
