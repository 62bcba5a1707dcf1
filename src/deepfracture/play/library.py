"""What can be broken, and with what: built-in shapes, files, uploads; breakers that are ready."""

from __future__ import annotations

import logging
import os
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepfracture.breakers import PatternBreaker, make_source
from deepfracture.breakers.base import PatternSource
from deepfracture.breakers.physical import Physical
from deepfracture.fracture import FractureBody
from deepfracture.fracture import material as preset
from deepfracture.geometry import BUILTIN, load_shape
from deepfracture.learn import embedded_model
from deepfracture.runtime.lru import LRU
from deepfracture.runtime.memory import release_free_memory
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Breaker, FracturePattern, Fragments, Grid, Impact, Material, Shape

GRID = Grid(64)
"""On which the page breaks things: a few milliseconds for the network, some seconds for the physics."""
WITHOUT_MODEL = ("physical", "voronoi", "cvd")
"""Breakers that need neither a model nor a data set."""
KEPT = 3
"""Breakers and stress solvers kept ready, the last used ones: a solver takes some 120 MB."""
KINDS = (".obj", ".stl", ".ply", ".glb")
"""Files that can be uploaded."""
UP = {".obj": "y", ".glb": "y"}
"""Axis that points up in most files of a kind; z in the others."""
TIDY = 2.0
"""Shortest time between two tidyings [s]."""
MOST_FACES = 500_000
"""Triangles of an uploaded mesh."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A shape that can be picked."""

    label: str
    """What the page calls it."""
    shape: Shape
    source: str
    """Built-in name, or the mesh file."""
    up: str = "z"
    """Axis that points up in its file."""
    repair: bool = False
    """Whether the file had to be mended ..."""
    mended: str = ""
    """... and what was done."""
    model: Path | None = None
    """Trained weights for it."""

    @property
    def file(self) -> Path | None:
        """The mesh file; None for a built-in shape."""
        return None if self.source in BUILTIN else Path(self.source)

    @property
    def breakers(self) -> tuple[str, ...]:
        """Those that can break it, the best first."""
        return WITHOUT_MODEL if self.model is None else ("learned", *WITHOUT_MODEL)


class Library:
    """Shapes and breakers that all players share; safe to use from several threads."""

    def __init__(self, shape: str | None = None, *, model: Path | None = None, up: str | None = None) -> None:
        """`shape`: a built-in shape or a mesh file to begin with, `model` its trained weights. BadInput as
        `load_shape` and `load_model` have it."""
        self._lock = threading.RLock()
        self._entries: dict[str, Entry] = {}
        self._sources: LRU[tuple, PatternSource] = LRU(KEPT)
        self._bodies: LRU[tuple, FractureBody] = LRU(KEPT)
        self._done: set[Hashable] = set()
        self._turns = Turns(os.cpu_count() or 1)
        self._tidied = -TIDY
        first = self._load(shape or "pot", model, up)
        self.first = first.label
        """What the page begins with."""
        self._entries[first.label] = first

    @property
    def labels(self) -> tuple[str, ...]:
        """All that can be picked, the first one first."""
        return (self.first, *(name for name in BUILTIN if name != self.first))

    def entry(self, label: str) -> Entry:
        """The shape with that label; made at the first call. BadInput for what is not in `labels`."""
        with self._lock:
            if label not in self._entries:
                if label not in self.labels:
                    raise BadInput(f"shape {label!r}: unknown; choose one of {', '.join(self.labels)}")
                self._entries[label] = self._load(label, None, None)
            return self._entries[label]

    def breaker(self, entry: Entry, name: str, material: str) -> Breaker:
        """A breaker for one world: what is costly is shared with others, what it learns of fragments is its own."""
        if name not in entry.breakers:
            raise BadInput(f"breaker {name!r} cannot break {entry.label}; choose one of {', '.join(entry.breakers)}")
        made_of = preset(material)
        if name == "physical":
            body = self._body(entry, made_of)
            source: PatternSource = Physical(made_of, GRID, {entry.shape: body})
        else:
            source = self._source(entry, name, made_of)
        return Queued(PatternBreaker(source, made_of), self._turns)

    def once(self, key: Hashable, job: Callable[[], object]) -> None:
        """Do a job unless one with that key has been done: others wait for it."""
        with self._lock:
            if key not in self._done:
                job()
                self._done.add(key)

    def tidy(self) -> None:
        """Give free memory back to the system, at most once in `TIDY` seconds: every world has threads, and without
        this twenty tabs hold a gigabyte of holes."""
        with self._lock:
            now = time.monotonic()
            if now - self._tidied < TIDY:
                return
            self._tidied = now
        release_free_memory()

    def _load(self, name: str, model: Path | None, up: str | None) -> Entry:
        shape = load_shape(name)
        if shape.name in BUILTIN and not Path(name).suffix:
            return Entry(shape.name, shape, shape.name, up or "z", model=model or embedded_model(shape.name))
        return Entry(shape.name, shape, name, up or UP.get(Path(name).suffix.lower(), "z"), model=model)

    def _source(self, entry: Entry, name: str, material: Material) -> PatternSource:
        def make() -> PatternSource:
            source = make_source(name, entry.shape, material, GRID, model=entry.model)
            return _InTurn(source, threading.Lock())

        with self._lock:
            return self._sources.get((entry, name, material.name), make)

    def _body(self, entry: Entry, material: Material) -> FractureBody:
        with self._lock:
            return self._bodies.get((entry, material.name), lambda: Physical(material, GRID).body(entry.shape))


@dataclass(frozen=True)
class _InTurn:
    """A source that several worlds ask, one after another."""

    source: PatternSource
    lock: threading.Lock

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with self.lock:
            return self.source(shape, impact, rng)


class Turns:
    """Lets in as many threads at once as there are places, in the order in which they came."""

    def __init__(self, places: int) -> None:
        self._lock = threading.Lock()
        self._free = places
        self._waiting: deque[threading.Event] = deque()

    def __enter__(self) -> None:
        with self._lock:
            if self._free:
                self._free -= 1
                return
            called = threading.Event()
            self._waiting.append(called)
        called.wait()

    def __exit__(self, *_: object) -> None:
        with self._lock:
            if self._waiting:
                self._waiting.popleft().set()  # who waits longest takes the place, before anybody new can
            else:
                self._free += 1


@dataclass(frozen=True)
class Queued:
    """A breaker that waits for its turn: all breaks at once would take as long, but each of them that long."""

    breaker: Breaker
    turns: Turns

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> Fragments | None:
        with self.turns:
            return self.breaker(shape, impact, rng)


def read_upload(content: bytes, name: str, folder: Path, *, limit: int) -> Entry:
    """An uploaded mesh, mended where it must be. `name` says what kind of file it is and what to call it, no more.

    The file goes into `folder`, which is made, under a name of our own. `limit`: greatest size [bytes].
    BadInput, in one line that names the file as the player does."""
    label, kind = _label(name), Path(name).suffix.lower()
    if kind not in KINDS:
        raise BadInput(f"{label}: unknown kind of file; drop one of {', '.join(KINDS)}")
    if len(content) > limit:
        raise BadInput(too_large(label, len(content), limit))
    folder.mkdir(parents=True)
    path = folder / f"mesh{kind}"
    path.write_bytes(content)
    try:
        shape, mended = _whole(path)
    except BadInput as problem:
        raise BadInput(str(problem).replace(str(path), label).replace("; try --repair", "")) from None
    if len(shape.mesh.faces) > MOST_FACES:
        raise BadInput(f"{label}: {len(shape.mesh.faces):,} triangles; thin it to {MOST_FACES:,} or fewer")
    return Entry(label, shape, str(path), UP.get(kind, "z"), bool(mended), mended.replace(str(path), label))


def too_large(label: str, size: int, limit: int) -> str:
    """The one message about the size of a file."""
    return (
        f"{label}: {size / 1e6:.0f} MB; at most {limit / 1e6:.0f} MB can be uploaded (deepfracture play --upload-limit)"
    )


def _label(name: str) -> str:
    """What a file may be called on the page: the last part of its name, plain characters, not too many."""
    last = re.split(r"[/\\]", name)[-1]
    return re.sub(r"[^\w .()-]", "_", last, flags=re.ASCII)[-40:] or "file"


def _whole(path: Path) -> tuple[Shape, str]:
    """The shape in a file, and what had to be mended, "" if nothing."""
    try:
        return load_shape(str(path)), ""
    except BadInput as problem:
        with _heard() as told:
            shape = load_shape(str(path), repair=True)
        return shape, told[-1] if told else str(problem)


@contextmanager
def _heard() -> Iterator[list[str]]:
    """What the program warns of in this thread, in place of the terminal."""
    told: list[str] = []
    own = threading.get_ident()

    class Ear(logging.Filter):
        def filter(self, record: logging.LogRecord) -> bool:
            if record.thread != own:
                return True
            if record.levelno >= logging.WARNING:
                told.append(record.getMessage())
            return False

    ear = Ear()
    log.addFilter(ear)
    try:
        yield told
    finally:
        log.removeFilter(ear)
