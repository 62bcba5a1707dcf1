"""Breakers that are ready: what is costly to make is shared by all players."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from deepfracture.breakers import PatternBreaker, make_source
from deepfracture.breakers.base import PatternSource
from deepfracture.breakers.physical import Physical
from deepfracture.fracture import FractureBody
from deepfracture.fracture import material as preset
from deepfracture.play.library import Entry
from deepfracture.runtime.lru import LRU
from deepfracture.runtime.memory import release_free_memory
from deepfracture.types import BadInput, Breaker, FracturePattern, Fragments, Grid, Impact, Material, Shape

GRID = Grid(64)
"""Resolution of the page's fractures: a few milliseconds for the network, some seconds for the physics."""
CACHE_SIZE = 3
"""Sources and stress solvers kept, the most recently used: a solver takes some 120 MB."""
RELEASE_PERIOD = 2.0
"""Shortest time between two releases of free memory [s]."""


class BreakerCache:
    """Makes breakers for the worlds of all players; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._sources: LRU[tuple, PatternSource] = LRU(CACHE_SIZE)
        self._bodies: LRU[tuple, FractureBody] = LRU(CACHE_SIZE)
        self._done: set[Hashable] = set()
        self._processors = FifoSemaphore(os.cpu_count() or 1)
        self._released = -RELEASE_PERIOD

    def breaker(self, entry: Entry, name: str, material: str) -> Breaker:
        """A breaker for one world, which shares what is costly; what it prepares of fragments is its own."""
        if name not in entry.breakers:
            raise BadInput(f"breaker {name!r} cannot break {entry.label}; choose one of {', '.join(entry.breakers)}")
        made_of = preset(material)
        if name == "physical":
            source: PatternSource = Physical(made_of, GRID, {entry.shape: self._body(entry, made_of)})
        else:
            source = self._source(entry, name, made_of)
        return QueuedBreaker(PatternBreaker(source, made_of), self._processors)

    def once(self, key: Hashable, job: Callable[[], object]) -> None:
        """Run a job unless one with that key has run; concurrent calls wait."""
        with self._lock:
            if key not in self._done:
                job()
                self._done.add(key)

    def release_memory(self) -> None:
        """Return free memory to the system, at most once in `RELEASE_PERIOD`: every world has threads, and otherwise
        twenty tabs hold a gigabyte of free memory."""
        with self._lock:
            now = time.monotonic()
            if now - self._released < RELEASE_PERIOD:
                return
            self._released = now
        release_free_memory()

    def _source(self, entry: Entry, name: str, material: Material) -> PatternSource:
        def make() -> PatternSource:
            source = make_source(name, entry.shape, material, GRID, model=entry.model)
            return _LockedSource(source, threading.Lock())

        with self._lock:
            return self._sources.get((entry, name, material.name), make)

    def _body(self, entry: Entry, material: Material) -> FractureBody:
        with self._lock:
            return self._bodies.get((entry, material.name), lambda: Physical(material, GRID).body(entry.shape))


@dataclass(frozen=True)
class _LockedSource:
    """A source shared by several worlds, which call it one after another."""

    source: PatternSource
    lock: threading.Lock

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with self.lock:
            return self.source(shape, impact, rng)


class FifoSemaphore:
    """A semaphore that admits threads in the order in which they came."""

    def __init__(self, places: int) -> None:
        self._lock = threading.Lock()
        self._free = places
        self._waiting: deque[threading.Event] = deque()

    def __enter__(self) -> None:
        with self._lock:
            if self._free:
                self._free -= 1
                return
            admitted = threading.Event()
            self._waiting.append(admitted)
        admitted.wait()

    def __exit__(self, *_: object) -> None:
        with self._lock:
            if self._waiting:
                self._waiting.popleft().set()  # hands the place over, before a new thread can take it
            else:
                self._free += 1


@dataclass(frozen=True)
class QueuedBreaker:
    """A breaker that waits for a processor: run all at once, each break would take as long as all of them."""

    breaker: Breaker
    processors: FifoSemaphore

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> Fragments | None:
        with self.processors:
            return self.breaker(shape, impact, rng)
