"""Part of docs/reports/evaluation.md: held-out score against the number of training patterns.

The network remembers its patterns nearly perfectly: `learned` and `no network` score alike in
docs/reports/evaluation.md. So the choice among stored patterns is measured, with random codes in place of learnt ones,
beside the nearest pattern. The first patterns of the training set stand for a smaller one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from harness import ROOT, row_of_axes, save_figure, start, table, write_text

from deepfracture.breakers import PatternSource, open_patterns
from deepfracture.breakers.stored_patterns import StoredPatterns
from deepfracture.compare import describe
from deepfracture.dataset import Dataset, open_dataset
from deepfracture.evaluate import Interval, evaluate, refuse_overlap, score_samples
from deepfracture.learn import Normaliser
from deepfracture.learn.partition.selector import MinimumRiskSelector, fit_kernel, pairwise_distances
from deepfracture.runtime.progress import stage
from deepfracture.types import BadInput, FracturePattern, Impact, Shape

SEGMENT_SIZE = 8


@dataclass(frozen=True, eq=False)
class Chosen:
    """The pattern of least Bayes risk among the first ones of a data set."""

    patterns: StoredPatterns
    normaliser: Normaliser
    selector: MinimumRiskSelector

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("choose"):
            random = rng.standard_normal(SEGMENT_SIZE, np.float32)
            return self.patterns.pattern(int(self.selector(self.normaliser(impact).astype(np.float32), random)[0]))


@dataclass(frozen=True, eq=False)
class Closest:
    """The first patterns' nearest impulse."""

    patterns: StoredPatterns
    normaliser: Normaliser
    count: int

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        with stage("nearest"):
            apart = ((self.patterns.rows[: self.count] - self.normaliser(impact)[0]) ** 2).sum(axis=1)
            return self.patterns.pattern(int(apart.argmin()))


def more_data(
    held: Annotated[Path, tyro.conf.Positional],
    dataset: Annotated[Path, tyro.conf.Positional],
    /,
    counts: tuple[int, ...] = (50, 100, 200, 500, 1000),
    draws: int = 3,
    out: Path = ROOT / "runs" / "more_data",
) -> Path:
    """Measure the choice among the first patterns; writes more_data.md and more_data.png.

    Args:
        held: held-out collisions, made with --repeats 4.
        dataset: training data; counts beyond its patterns are left out, and all of them taken as the last.
        counts: training patterns.
        draws: random codes for each collision.
        out: folder for the results.
    """
    unseen, train = open_dataset(held), open_dataset(dataset)
    refuse_overlap(unseen, train)
    sizes = sorted({min(count, len(train)) for count in counts})
    if sizes[0] < 2:
        raise BadInput(f"counts must be 2 at least, got {counts}")
    samples = score_samples(evaluate(unseen, sources(train, sizes), draws=draws, seed=0))
    found = {name: Interval.of(values) for name, values in samples.items()}
    rows = [(size, *(_cell(found[f"{kind} of {size}"]) for kind in ("nearest", "typical"))) for size in sizes]
    text = f"# More data: {train.shape.name}\n\n{table(('patterns', 'nearest', 'typical'), rows)}\n"
    write_text(out / "more_data.md", text + "\n![more_data.png](more_data.png)\n")
    plot(sizes, found, out / "more_data.png")
    return out / "more_data.md"


def sources(train: Dataset, sizes: Sequence[int]) -> dict[str, PatternSource]:
    """Both ways to choose, for each number of patterns."""
    patterns = open_patterns(train.shape, train.path)
    patterns.load()
    impacts = train.impacts()
    normaliser = Normaliser(train.max_impulse)
    rows = np.stack([normaliser(impact) for impact in impacts]).astype(np.float32)
    apart = pairwise_distances([describe(patterns.pattern(index), impacts[0]) for index in range(len(train))])
    segment = np.random.default_rng(0).standard_normal((len(rows), SEGMENT_SIZE)).astype(np.float32)
    whole = MinimumRiskSelector(rows, segment, apart, fit_kernel(rows, apart))
    found: dict[str, PatternSource] = {}
    for n in sizes:
        kernel = fit_kernel(rows[:n], apart[:n, :n])
        part = replace(whole, impulses=rows[:n], segment=segment[:n], pairwise=apart[:n, :n], kernel=kernel)
        found[f"nearest of {n}"] = Closest(patterns, normaliser, n)
        found[f"typical of {n}"] = Chosen(patterns, normaliser, part)
    return found


def plot(sizes: Sequence[int], found: dict[str, Interval], path: Path) -> None:
    figure, (axes,) = row_of_axes(1, (5.5, 3.6))
    for kind in ("nearest", "typical"):
        of = [found[f"{kind} of {size}"] for size in sizes]
        axes.fill_between(sizes, [one.low for one in of], [one.high for one in of], alpha=0.15)
        axes.plot(sizes, [one.value for one in of], marker="o", label=kind)
    axes.axhline(1, color="0.6", linewidth=0.8)
    axes.set(xlabel="training patterns", ylabel="score (mean of 8 measures)", xscale="log")
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.legend()
    save_figure(figure, path, 130)


def _cell(interval: Interval) -> str:
    return f"{interval.value:.2f} ({interval.low:.2f} to {interval.high:.2f})"


if __name__ == "__main__":
    start(more_data)
