"""The shapes that can be broken on the page."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path

from deepfracture.geometry import BUILTIN, load_shape
from deepfracture.learn import embedded_model
from deepfracture.types import BadInput, Shape

UNTRAINED = ("physical", "voronoi", "cvd")
"""Breakers that need neither a model nor a data set."""
UP_AXIS = {".obj": "y", ".glb": "y"}
"""Axis that points up in most files with a suffix; z in the others."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A shape that can be picked."""

    label: str
    """Its name on the page."""
    shape: Shape
    source: str
    """Built-in name, or the mesh file."""
    up: str = "z"
    """Axis that points up in its file."""
    repair: bool = False
    """Whether the file had to be repaired ..."""
    repairs: str = ""
    """... and what was repaired."""
    model: Path | None = None
    """Trained weights for it."""

    @property
    def file(self) -> Path | None:
        """The mesh file; None for a built-in shape."""
        return None if self.source in BUILTIN else Path(self.source)

    @property
    def breakers(self) -> tuple[str, ...]:
        """Names of the breakers that can break it, the best first."""
        return UNTRAINED if self.model is None else ("learned", *UNTRAINED)


class Library:
    """Shapes that all players share; thread-safe."""

    def __init__(self, shape: str | None = None, *, model: Path | None = None, up: str | None = None) -> None:
        """`shape`: a built-in shape or a mesh file to begin with, `model` its trained weights. BadInput as in
        `load_shape` and `load_model`."""
        self._lock = threading.Lock()
        self._entries: dict[str, Entry] = {}
        first = _load(shape or "pot", model, up)
        self.first = first.label
        """The shape with which the page begins."""
        self._entries[first.label] = first

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of all shapes, the first one first."""
        return (self.first, *(name for name in BUILTIN if name != self.first))

    def entry(self, label: str) -> Entry:
        """The shape with that label, loaded at the first call. BadInput: it is not in `labels`."""
        with self._lock:
            if label not in self._entries:
                if label not in self.labels:
                    raise BadInput(f"shape {label!r}: unknown; choose one of {', '.join(self.labels)}")
                self._entries[label] = _load(label, None, None)
            return self._entries[label]


def _load(name: str, model: Path | None, up: str | None) -> Entry:
    shape = load_shape(name)
    if shape.name in BUILTIN and not Path(name).suffix:
        return Entry(shape.name, shape, shape.name, up or "z", model=model or embedded_model(shape.name))
    return Entry(shape.name, shape, name, up or UP_AXIS.get(Path(name).suffix.lower(), "z"), model=model)
