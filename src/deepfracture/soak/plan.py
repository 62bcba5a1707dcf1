"""The cases of a soak: which hit strikes which shape with which breaker, and the command that repeats it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from deepfracture.breakers import BREAKERS
from deepfracture.geometry import BUILTIN, load_shape
from deepfracture.geometry.builtin import plain_name
from deepfracture.learn import embedded_model, load_model
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import RESOLUTIONS, BadInput
from deepfracture.world import ENGINES

SHARES = {"learned": 3, "voronoi": 3, "cvd": 3, "nearest": 2, "random": 2, "physical": 1}
"""Relative frequency of each breaker: the physical one takes several times as long as the others."""
DEFAULT_RESOLUTION = 64
"""Voxels along each axis ..."""
PHYSICAL_RESOLUTION = 32
"""... and for the physical breaker."""
DATASET_BREAKERS = ("nearest", "random")
"""Breakers that need a data set of the shape."""


@dataclass(frozen=True)
class SoakOptions:
    """Options of a soak. Hit k depends on them and (seed, k) alone."""

    shapes: tuple[str, ...] = ()
    """Built-in names or mesh files; empty: every built-in shape."""
    breakers: tuple[str, ...] = ()
    """Empty: every breaker that can break at least one of the shapes."""
    seed: int = 0
    resolution: int | None = None
    """Voxels along each axis; None: `DEFAULT_RESOLUTION`, and `PHYSICAL_RESOLUTION` for the physical breaker."""
    engine: str = "rapier"
    repair: bool = False
    """Repair open meshes."""
    model: Path | None = None
    """Trained weights, used for the shape that they fit."""
    data: Path | None = None
    """Folder with a data set for each shape, by its name, for nearest and random."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "shapes", tuple(_source(name) for name in self.shapes or BUILTIN))
        for name in self.breakers:
            if name not in BREAKERS:
                raise BadInput(
                    f"breaker {name!r}: unknown; choose from {', '.join(BREAKERS)}{did_you_mean(name, BREAKERS)}"
                )
        if self.engine not in ENGINES:
            raise BadInput(f"engine must be one of {', '.join(ENGINES)}, got {self.engine!r}")
        if self.resolution is not None and self.resolution not in RESOLUTIONS:
            raise BadInput(f"resolution must be one of {RESOLUTIONS}, got {self.resolution}")
        if self.seed < 0:
            raise BadInput(f"seed must be zero or more, got {self.seed}")


@dataclass(frozen=True)
class Case:
    """One hit."""

    number: int
    """k"""
    seed: int
    """Seed of everything random in it. Hit k of seed s is hit 0 of seed s + k, so one number repeats it."""
    shape: str
    """Built-in name or mesh file."""
    breaker: str
    resolution: int

    def command(self, options: SoakOptions) -> str:
        """The command that repeats this hit alone."""
        words = ["deepfracture", "soak", self.shape, "--breakers", self.breaker, "--seed", str(self.seed)]
        words += ["--hits", "1"]
        for name in ("resolution", "model", "data"):
            value = getattr(options, name)
            words += [] if value is None else [f"--{name}", str(value)]
        words += [] if options.engine == "rapier" else ["--engine", options.engine]
        words += ["--repair"] if options.repair else []
        return shlex.join(words)


def first_cases(options: SoakOptions, hits: int) -> Iterator[Case]:
    """The first `hits` cases. Any number of them is divided among the breakers by `SHARES`, and the cases of a breaker
    evenly among the shapes, to within one.

    Raises:
        BadInput: A shape cannot be used, or a breaker can break none of them.
    """
    return islice(_cases(options, ready(options)), hits)


def case(options: SoakOptions, number: int) -> Case:
    """Case `number`."""
    return next(islice(first_cases(options, number + 1), number, None))


def ready(options: SoakOptions) -> dict[str, tuple[str, ...]]:
    """The shapes that each breaker can break. BadInput as in `first_cases`."""
    for source in options.shapes:
        if source not in BUILTIN:
            load_shape(source, repair=options.repair)  # raises if it cannot be used
    fits = {source: _breakers(source, options) for source in options.shapes}
    wanted = options.breakers or tuple(name for name in SHARES if any(name in fit for fit in fits.values()))
    found = {name: tuple(source for source, fit in fits.items() if name in fit) for name in wanted}
    for name, sources in found.items():
        if not sources:
            need = "--data FOLDER" if name in DATASET_BREAKERS else "--model FILE"
            raise BadInput(f"breaker {name!r} is ready for none of {', '.join(options.shapes)}; give {need}")
    return found


def _cases(options: SoakOptions, shapes: dict[str, tuple[str, ...]]) -> Iterator[Case]:
    """Smooth weighted round-robin: each case goes to the breaker that lags furthest behind its share."""
    total = sum(SHARES[name] for name in shapes)
    credit, turns, number = dict.fromkeys(shapes, 0), dict.fromkeys(shapes, 0), 0
    while True:
        credit = {name: have + SHARES[name] for name, have in credit.items()}
        breaker = max(credit, key=lambda name: credit[name])
        credit[breaker] -= total
        sources = shapes[breaker]
        resolution = options.resolution or (PHYSICAL_RESOLUTION if breaker == "physical" else DEFAULT_RESOLUTION)
        yield Case(number, options.seed + number, sources[turns[breaker] % len(sources)], breaker, resolution)
        turns[breaker] += 1
        number += 1


def _source(name: str) -> str:
    return plain_name(name) if plain_name(name) in BUILTIN else name


def model_of(source: str, options: SoakOptions) -> Path | None:
    """Trained weights for a shape."""
    if options.model is not None and load_model(options.model).matches_shape(load_shape(source, repair=options.repair)):
        return options.model
    return embedded_model(source) if source in BUILTIN else None


def data_of(source: str, options: SoakOptions) -> Path | None:
    """The data set of a shape."""
    folder = None if options.data is None else options.data / Path(source).stem
    return folder if folder is not None and folder.is_dir() else None


def _breakers(source: str, options: SoakOptions) -> set[str]:
    """The breakers that can break a shape."""
    found: set[str] = set(BREAKERS)
    if model_of(source, options) is None:
        found.remove("learned")
    if data_of(source, options) is None:
        found -= set(DATASET_BREAKERS)
    return found
