"""Summary of docs/reports/evaluation.md: the mean score of every source over several shapes, table and plot.

Reads what `deepfracture evaluate` wrote. The 95 % intervals are those of a bootstrap over collisions and draws, each
shape's for itself. A source that is missing for a shape has no mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from harness import ROOT, row_of_axes, save_figure, start, table, write_json, write_text

from deepfracture.compare import MEASURES
from deepfracture.evaluate import Evaluation, Interval, Summary, load_evaluation, score_samples, summarise
from deepfracture.evaluate.plots import COLOURS, INK
from deepfracture.types import BadInput, Floats

BASELINE = "nearest"


def evaluation(
    folders: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")],
    /,
    out: Path = ROOT / "runs" / "evaluation",
) -> Path:
    """Merge evaluations; writes scores.md, scores.json and scores.png.

    Args:
        folders: each with an evaluation.json, one for each shape.
        out: folder for the results.
    """
    if not folders:
        raise BadInput("folders: none given; make some with deepfracture evaluate")
    evaluations = [load_evaluation(folder / "evaluation.json") for folder in folders]
    names = [one.shape for one in evaluations]
    if len(set(names)) < len(names):
        raise BadInput(f"folders: two of them are of one shape ({', '.join(names)}); give one for each shape")
    samples = {one.shape: score_samples(one) for one in evaluations}
    summaries = {one.shape: summarise(one) for one in evaluations}
    found = means(samples)
    write_json(out / "scores.json", {name: asdict(mean) for name, mean in found.items()})
    write_text(out / "scores.md", report(evaluations, summaries, found, against(samples)))
    plot(summaries, found, out / "scores.png")
    return out / "scores.md"


def means(samples: Mapping[str, Mapping[str, Floats]]) -> dict[str, Interval]:
    """Mean over the shapes of each source that all of them have, best first.

    Args:
        samples: By shape and source, `score_samples`.
    """
    found = {name: Interval.of(np.mean([of[name] for of in samples.values()], axis=0)) for name in _common(samples)}
    return dict(sorted(found.items(), key=lambda item: item[1].value))


def against(samples: Mapping[str, Mapping[str, Floats]]) -> dict[str, Interval]:
    """Mean over the shapes of each source's score minus that of BASELINE, on the same bootstrap samples."""
    common = _common(samples)
    if BASELINE not in common:
        return {}
    apart = {name: [of[name] - of[BASELINE] for of in samples.values()] for name in common if name != BASELINE}
    return {name: Interval.of(np.mean(values, axis=0)) for name, values in apart.items()}


def report(
    evaluations: Sequence[Evaluation],
    summaries: Mapping[str, Mapping[str, Summary]],
    found: Mapping[str, Interval],
    difference: Mapping[str, Interval],
) -> str:
    """scores.md."""
    shapes = list(summaries)
    collisions = ", ".join(f"{one.shape} {len(one.collisions)}" for one in evaluations)
    return "\n\n".join([
        f"Mean score over {len(shapes)} shapes (held-out collisions: {collisions}), 95 % intervals. 1 is as near to a "
        "simulation as another simulation is; lower is better.",
        table(
            ("source", "mean score", f"minus that of {BASELINE}", *shapes, "diversity", "energy", "time [ms]"),
            [_row(name, [of[name] for of in summaries.values()], found, difference) for name in found],
        ).rstrip(),
        "Each measure, mean over the shapes:",
        table(
            ("source", *MEASURES),
            [(name, *(_mean([of[name].measures[m].value for of in summaries.values()]) for m in MEASURES))
             for name in found],
        ),
    ])  # fmt: skip


def plot(summaries: Mapping[str, Mapping[str, Summary]], found: Mapping[str, Interval], path: Path) -> None:
    """The score of every source on every shape, and the mean."""
    figure, (axes,) = row_of_axes(1, (9, 0.8 + 0.32 * len(found)))
    rows = np.arange(len(found))
    for number, (shape, of) in enumerate(summaries.items()):
        marks = [of[name].score.value for name in found]
        axes.plot(marks, rows, "o", ms=4, alpha=0.6, color=COLOURS[number % len(COLOURS)], label=shape)
    for row, mean in zip(rows, found.values(), strict=True):
        axes.plot([mean.low, mean.high], [row, row], color=INK, lw=1.5)
        axes.plot(mean.value, row, "D", ms=6, color=INK, label="mean, 95 %" if row == 0 else None)
    axes.axvline(1, color=INK, lw=1, ls="--")
    axes.set_yticks(rows, list(found))
    axes.invert_yaxis()
    axes.set(xlabel="score: distance / floor; 1 is as near as another simulation", xscale="log")
    ticks = [1, 1.2, 1.5, 2, 3, 4, 5]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.legend(frameon=False, fontsize=8)
    save_figure(figure, path)


def _common(samples: Mapping[str, Mapping[str, Floats]]) -> list[str]:
    first, *others = samples.values()
    return [name for name in first if all(name in other for other in others)]


def _row(
    name: str, of: Sequence[Summary], found: Mapping[str, Interval], difference: Mapping[str, Interval]
) -> tuple[Any, ...]:
    return (
        name, found[name], difference.get(name, ""), *(f"{one.score.value:.2f}" for one in of),
        _mean([one.diversity.value for one in of]), _mean([one.energy.value for one in of]),
        f"{np.mean([one.milliseconds for one in of]):.1f}",
    )  # fmt: skip


def _mean(values: Sequence[float]) -> str:
    return f"{np.mean(values):.2f}"


if __name__ == "__main__":
    start(evaluation)
