"""All held-out collisions, measured, and stored in one file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepfracture.breakers import PatternSource
from deepfracture.compare import describe
from deepfracture.dataset import Dataset
from deepfracture.evaluate.collision import HeldOutCollision, Measurement, SourceResult, measure
from deepfracture.evaluate.sensitivity import sensitivities
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import track
from deepfracture.types import BadInput, Impact, Shape

FORMAT = 1


@dataclass(frozen=True)
class Evaluation:
    """The predictions of several sources for the held-out collisions of one shape."""

    shape: str
    material: str
    resolution: int
    draws: int
    """Random codes per source and collision."""
    seed: int
    left_out: int
    """Collisions of which fewer than two repeats broke the shape: they have no floor."""
    sensitivity: dict[str, float]
    """See `sensitivity.sensitivities`."""
    collisions: tuple[HeldOutCollision, ...]

    @property
    def sources(self) -> tuple[str, ...]:
        return tuple(self.collisions[0].answers)

    def save(self, path: Path, **more: Any) -> None:
        """Write everything, and `more` beside it, as JSON."""
        value = {"format": FORMAT, **more, **asdict(self)}
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def evaluate(held: Dataset, sources: Mapping[str, PatternSource], *, draws: int, seed: int) -> Evaluation:
    """Measure sources on held-out collisions. The same seed gives the same numbers, times apart.

    Args:
        held: Collisions simulated several times each, none of which any source knows.
        sources: By the names that they get in tables.
        draws: Random codes for each collision.

    Raises:
        BadInput: No collision has two repeats that broke, or a source gives patterns of another resolution.
    """
    if draws < 1 or not sources:
        raise BadInput(f"draws must be at least 1 and sources some, got {draws} and {len(sources)}")
    with_floor = [group for group in held.collisions() if len(group) > 1]
    tried = -(-held.tried // held.settings.repeats)  # one that broke nothing at all is in no group
    if not with_floor:
        raise BadInput(
            f"{held.path}: no collision broke the shape twice, so there is no chaos floor; simulate the held-out set "
            "with --repeats 4"
        )
    first = held[with_floor[0][0]]
    inside = np.flatnonzero(describe(first.pattern, first.impact).partition)
    _warm(held.shape, first.impact, sources, seed)
    measured: list[Measurement] = []
    for group in track(with_floor, name="held-out collisions"):
        samples = [held[index] for index in group]
        number = int(held.names[group[0]]) // held.settings.repeats
        measured.append(measure(number, samples, held.shape, sources, inside=inside, draws=draws, seed=seed))
    return Evaluation(
        held.shape.name, held.material.name, held.settings.resolution, draws, seed, tried - len(with_floor),
        sensitivities(measured), tuple(one.collision for one in measured),
    )  # fmt: skip


def load_evaluation(path: Path | str) -> Evaluation:
    """Read what `Evaluation.save` wrote.

    Raises:
        BadInput: The file is not there or is something else.
    """
    path = Path(path)
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
        if value["format"] != FORMAT:
            raise ValueError(f"format {value['format']}, this program reads {FORMAT}")
        names = Evaluation.__dataclass_fields__
        kept = {name: value[name] for name in names if name != "collisions"}
        return Evaluation(**kept, collisions=tuple(_collision(row) for row in value["collisions"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{path}: not an evaluation ({str(error).splitlines()[0]}); make one with evaluate") from error


def _collision(row: dict[str, Any]) -> HeldOutCollision:
    answers = {name: _source_result(answer) for name, answer in row["answers"].items()}
    lists = {name: _tuples(row[name]) for name in ("position", "direction", "volumes")}
    return HeldOutCollision(**{**row, **lists, "answers": answers})


def _source_result(row: dict[str, Any]) -> SourceResult:
    return SourceResult(**{name: _tuples(value) for name, value in row.items()})


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _warm(shape: Shape, impact: Impact, sources: Mapping[str, PatternSource], seed: int) -> None:
    """Call every source once, so that no time includes one-off work (compilation, files, the shape)."""
    for source in sources.values():
        source(shape, impact, np.random.default_rng(seed))
