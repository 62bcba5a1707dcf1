"""Which hit of a soak strikes which shape with which breaker, and how to repeat it."""

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
"""How often each breaker has its turn: the physical one takes several times as long as the others."""
USUAL = 64
"""Voxels along each axis ..."""
SLOW = 32
"""... and for the physical breaker."""
RECALLING = ("nearest", "random")
"""Breakers that need a data set of the shape."""


@dataclass(frozen=True)
class Settings:
    """What a soak is made of. Hit k depends on these and (seed, k) alone."""

    shapes: tuple[str, ...] = ()
    """Built-in names or mesh files; none: every built-in shape."""
    breakers: tuple[str, ...] = ()
    """None: every one that is ready for at least one of the shapes."""
    seed: int = 0
    resolution: int | None = None
    """Voxels along each axis; None: `USUAL`, and `SLOW` for the physical breaker."""
    engine: str = "rapier"
    repair: bool = False
    """Mend meshes that are not closed."""
    model: Path | None = None
    """Trained weights of the shape that they fit."""
    data: Path | None = None
    """Folder that holds a data set for each shape, by its name: nearest and random recall them."""

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
    """Of everything that is random in it. Hit k of seed s is hit 0 of seed s + k, so that one number repeats it."""
    shape: str
    """Built-in name or mesh file."""
    breaker: str
    resolution: int

    def command(self, settings: Settings) -> str:
        """What repeats this hit and no other."""
        words = ["deepfracture", "soak", self.shape, "--breakers", self.breaker, "--seed", str(self.seed)]
        words += ["--hits", "1"]
        for name in ("resolution", "model", "data"):
            value = getattr(settings, name)
            words += [] if value is None else [f"--{name}", str(value)]
        words += [] if settings.engine == "rapier" else ["--engine", settings.engine]
        words += ["--repair"] if settings.repair else []
        return shlex.join(words)


def numbered(settings: Settings, hits: int) -> Iterator[Case]:
    """The first `hits` hits. However many they are, breakers have their shares of them, and of those of a breaker
    each shape has as many as the others, give or take one.

    Raises:
        BadInput: A shape cannot be used, or a breaker is ready for none of them.
    """
    return islice(_cases(settings, ready(settings)), hits)


def case(settings: Settings, number: int) -> Case:
    """Hit `number`."""
    return next(islice(numbered(settings, number + 1), number, None))


def ready(settings: Settings) -> dict[str, tuple[str, ...]]:
    """For each breaker the shapes that it can break. BadInput as in `numbered`."""
    for source in settings.shapes:
        if source not in BUILTIN:
            load_shape(source, repair=settings.repair)  # complains of what cannot be used
    fits = {source: _breakers(source, settings) for source in settings.shapes}
    wanted = settings.breakers or tuple(name for name in SHARES if any(name in fit for fit in fits.values()))
    found = {name: tuple(source for source, fit in fits.items() if name in fit) for name in wanted}
    for name, sources in found.items():
        if not sources:
            need = "--data FOLDER" if name in RECALLING else "--model FILE"
            raise BadInput(f"breaker {name!r} is ready for none of {', '.join(settings.shapes)}; give {need}")
    return found


def _cases(settings: Settings, shapes: dict[str, tuple[str, ...]]) -> Iterator[Case]:
    """Each turn goes to the breaker that lags furthest behind its share."""
    total = sum(SHARES[name] for name in shapes)
    credit, turns, number = dict.fromkeys(shapes, 0), dict.fromkeys(shapes, 0), 0
    while True:
        credit = {name: have + SHARES[name] for name, have in credit.items()}
        breaker = max(credit, key=lambda name: credit[name])
        credit[breaker] -= total
        sources = shapes[breaker]
        resolution = settings.resolution or (SLOW if breaker == "physical" else USUAL)
        yield Case(number, settings.seed + number, sources[turns[breaker] % len(sources)], breaker, resolution)
        turns[breaker] += 1
        number += 1


def _source(name: str) -> str:
    return plain_name(name) if plain_name(name) in BUILTIN else name


def model_of(source: str, settings: Settings) -> Path | None:
    """Trained weights for a shape."""
    if settings.model is not None and load_model(settings.model).matches_shape(
        load_shape(source, repair=settings.repair)
    ):
        return settings.model
    return embedded_model(source) if source in BUILTIN else None


def data_of(source: str, settings: Settings) -> Path | None:
    """The data set of a shape."""
    folder = None if settings.data is None else settings.data / Path(source).stem
    return folder if folder is not None and folder.is_dir() else None


def _breakers(source: str, settings: Settings) -> set[str]:
    """Those that can break a shape."""
    found: set[str] = set(BREAKERS)
    if model_of(source, settings) is None:
        found.remove("learned")
    if data_of(source, settings) is None:
        found -= set(RECALLING)
    return found
