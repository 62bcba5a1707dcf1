"""Pictures of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.compare import MEASURES
from deepfracture.evaluate.evaluation import Evaluation
from deepfracture.evaluate.summary import Interval, Summary, mott_larger, relative_volumes, simulated
from deepfracture.runtime.files import atomic_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, PALE = "#33414d", "#b9c3ca"
COLOURS = ("#bd5e3d", "#2f7f86", "#8a6fb0", "#c09a2b", "#5a8f4e", "#a8506b", "#4f74b3", "#7d7468")


def plot_scores(found: dict[str, Summary], title: str, path: Path) -> None:
    """The score of every source on every measure, best source first; the line is the floor."""
    figure, axes = _figure((11, 4.2))
    best = sorted(found, key=lambda name: found[name].score.value)
    for number, name in enumerate(best):
        bars = [found[name].score, *(found[name].measures[measure] for measure in MEASURES)]
        place = np.arange(len(bars)) + (number - (len(best) - 1) / 2) * 0.8 / len(best)
        _with_errors(axes, place, bars, COLOURS[list(found).index(name) % len(COLOURS)], name)
    axes.axhline(1, color=INK, lw=1, ls="--")
    axes.axvline(0.5, color=PALE, lw=1)
    axes.set_xticks(range(len(MEASURES) + 1), ["score", *MEASURES])
    axes.set(ylabel="distance / floor", title=f"{title}: 1 is as near as another simulation", yscale="log")
    ticks = [tick for tick in (0.5, 0.7, 1, 1.5, 2, 3, 5, 8) if axes.get_ylim()[0] < tick < axes.get_ylim()[1]]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.legend(frameon=False, fontsize=8, ncols=len(best), loc="upper right")
    _save(figure, path)


def plot_volumes(evaluation: Evaluation, found: dict[str, Summary], path: Path) -> None:
    """Share of fragments larger than V / V_mean, as the paper has it, with Mott's curve."""
    figure, axes = _figure((5.6, 4.6))
    truth = [volumes for row in evaluation.collisions for volumes in row.volumes]
    _larger(axes, truth, INK, f"simulation, KS to Mott {simulated(evaluation)['mott']:.2f}", 2)
    for number, (name, summary) in enumerate(found.items()):
        volumes = [one for row in evaluation.collisions for one in row.answers[name].volumes]
        label = f"{name}, KS to simulation {summary.volumes:.2f}"
        _larger(axes, volumes, COLOURS[number % len(COLOURS)], label, 1.2)
    size = np.geomspace(1e-3, 30, 200)
    axes.plot(size, mott_larger(size), color=INK, lw=1, ls="--", label="Mott")
    axes.set(
        xscale="log", yscale="log", xlim=(1e-3, 30), ylim=(2e-3, 1.3), xlabel="V / V_mean",
        ylabel="share of fragments larger", title=evaluation.shape,
    )  # fmt: skip
    axes.legend(frameon=False, fontsize=8, loc="lower left")
    _save(figure, path)


def plot_counts(evaluation: Evaluation, found: dict[str, Summary], path: Path) -> None:
    """Fragments against impulse, a panel for each source, over the simulations in grey."""
    from matplotlib.figure import Figure

    columns = min(3, len(found))
    rows = -(-len(found) // columns)
    figure = Figure(figsize=(3.6 * columns, 2.9 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel in panels[len(found) :]:
        panel.set_axis_off()
    for number, (panel, (name, summary)) in enumerate(zip(panels, found.items(), strict=False)):
        for row in evaluation.collisions:
            panel.plot([row.impulse] * len(row.counts), row.counts, "o", color=PALE, ms=3.5)
            counts = row.answers[name].counts
            panel.plot([row.impulse] * len(counts), counts, "o", color=COLOURS[number % len(COLOURS)], ms=2.5)
        panel.set(title=f"{name}: rank correlation {summary.rising.value:.2f}", yscale="log")
        panel.title.set_fontsize(9)
    figure.supxlabel("impulse [N s]", fontsize=9)
    figure.supylabel("fragments (grey: simulations)", fontsize=9)
    _save(figure, path)


def _with_errors(axes: Axes, place: np.ndarray, bars: Sequence[Interval], colour: str, label: str) -> None:
    value = np.array([bar.value for bar in bars])
    # A bootstrap interval need not hold the value itself.
    below = np.maximum(0, value - [bar.low for bar in bars])
    above = np.maximum(0, np.array([bar.high for bar in bars]) - value)
    axes.errorbar(place, value, yerr=[below, above], fmt="o", color=colour, ms=4, lw=1.2, label=label)


def _larger(axes: Axes, volumes: Sequence[Sequence[float]], colour: str, label: str, width: float) -> None:
    sizes = relative_volumes(volumes)
    axes.step(sizes, 1 - np.arange(len(sizes)) / len(sizes), where="pre", color=colour, lw=width, label=label)


def _figure(size: tuple[float, float]) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots()


def _save(figure: Figure, path: Path) -> None:
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=110)
