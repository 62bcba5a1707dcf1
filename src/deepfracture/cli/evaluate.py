"""`evaluate`: measure breakers and models on held-out collisions."""

from __future__ import annotations

import logging
from pathlib import Path

from deepfracture.breakers import PatternSource, ablations, make_source, open_patterns
from deepfracture.dataset import Dataset, open_dataset
from deepfracture.evaluate import evaluate as run
from deepfracture.evaluate import refuse_overlap, write_report
from deepfracture.evaluate.report import score_table
from deepfracture.runtime.extras import require
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Grid


def evaluate(
    held: Path, *, dataset: Path | None, model: tuple[str, ...], breakers: tuple[str, ...], ablation: bool, out: Path,
    draws: int, seed: int,
) -> None:  # fmt: skip
    """Measure breakers and models on the held-out collisions in the folder `held`; tables and plots go to `out`."""
    require("matplotlib", extra="plots", to="draw the plots of an evaluation")
    unseen = open_dataset(held)
    sources = _sources(unseen, dataset, model, breakers, ablation=ablation)
    level = log.level
    log.setLevel(logging.WARNING)  # the stages of every call would bury the table
    try:
        found = write_report(run(unseen, sources, draws=draws, seed=seed), out)
    finally:
        log.setLevel(level)
    log.info("%s\n\n%s", score_table(found), out / "evaluation.md")


def _sources(
    held: Dataset, dataset: Path | None, model: tuple[str, ...], breakers: tuple[str, ...], *, ablation: bool
) -> dict[str, PatternSource]:
    """Sources by their names in the tables."""
    if not len(held):
        raise BadInput(f"{held.path}: no collision broke the shape; simulate faster balls, with --repeats 4")
    patterns = None
    if dataset is not None:
        patterns = open_patterns(held.shape, dataset)
        refuse_overlap(held, patterns.dataset)
        patterns.load()  # what is read later would count as the time of a prediction
    shape, material, grid = held.shape, held.material, Grid(held.settings.resolution)
    models = _models(model)
    names = [*breakers, *(name for name, _ in models)]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"{name}: given twice; name models with --model NAME=FILE")
    sources = {name: make_source(name, shape, material, grid, patterns=patterns) for name in breakers}
    for number, (name, path) in enumerate(models):
        dissected = ablation and number == 0
        parts = ablations(shape, material, path, patterns if dissected else None)
        for part, source in parts.items() if dissected else [("", parts[""])]:
            sources[f"{name}, {part}" if part else name] = source
    return sources


def _models(model: tuple[str, ...]) -> list[tuple[str, Path]]:
    """NAME=FILE, or a file, which is named `learned`."""
    pairs = [text.split("=", 1) if "=" in text else ("learned", text) for text in model]
    return [(name, Path(path)) for name, path in pairs]
