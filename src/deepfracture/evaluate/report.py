"""An evaluation as a folder: evaluation.json, evaluation.md and plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from deepfracture.compare import MEASURES
from deepfracture.evaluate.evaluation import Evaluation
from deepfracture.evaluate.plots import plot_counts, plot_scores, plot_volumes
from deepfracture.evaluate.summary import BASELINE, Interval, Summary, floors, simulated, summarise
from deepfracture.runtime.files import atomic_file

UNITS = {"centre": "m", "chamfer": "m", "division": "bits"}
"""Of measures that are not ratios."""
PLOTS = ("scores.png", "volumes.png", "counts.png")


def write_report(evaluation: Evaluation, out: Path) -> dict[str, Summary]:
    """Write everything into the folder `out`.

    Returns:
        The figures of each source, as in the tables.
    """
    out.mkdir(parents=True, exist_ok=True)
    found = summarise(evaluation)
    figures = {name: asdict(summary) for name, summary in found.items()}
    more = {"floor": floors(evaluation), "simulation": simulated(evaluation), "summary": figures}
    evaluation.save(out / "evaluation.json", **_plain(more))
    _write(out / "evaluation.md", markdown(evaluation, found))
    plot_scores(found, evaluation.shape, out / PLOTS[0])
    plot_volumes(evaluation, found, out / PLOTS[1])
    plot_counts(evaluation, found, out / PLOTS[2])
    return found


def markdown(evaluation: Evaluation, found: dict[str, Summary]) -> str:
    """The tables of evaluation.md."""
    rows = evaluation.collisions
    floor, truth = floors(evaluation), simulated(evaluation)
    lines = [
        f"# {evaluation.shape}: {len(rows)} held-out collisions",
        f"{evaluation.material}, r = {evaluation.resolution}, {sum(len(row.counts) for row in rows)} simulations, "
        f"{evaluation.draws} draws of each source for each collision, seed {evaluation.seed}. {evaluation.left_out} "
        "collisions that broke the shape less than twice are left out.",
        "Scores are mean distances to the simulations over the floor, the mean distance of two simulations of one "
        "collision; lower is better, and 1 is as near as another simulation. A guess in the middle of what may happen "
        "can be nearer than that, but has no diversity (distance between draws over the floor); energy, twice the "
        "score less diversity less 1, is 0 only for draws that are spread as simulations are. In brackets: 95 % "
        "intervals by bootstrap over collisions and draws.",
        "## Scores",
        score_table(found),
        "## Measures",
        measure_table(found, floor),
        "## More",
        more_table(found, truth),
        *[f"![{name}]({name})" for name in PLOTS],
    ]
    return "\n\n".join(lines) + "\n"


def score_table(found: dict[str, Summary]) -> str:
    """Sources, best first."""
    head = (
        "source",
        f"score (mean of {len(MEASURES)})",
        f"minus that of {BASELINE}",
        "diversity",
        "energy",
        "time [ms]",
    )
    best = sorted(found, key=lambda name: found[name].score.value)
    return table(head, [_score_row(name, found[name]) for name in best])


def _score_row(name: str, summary: Summary) -> Sequence[Any]:
    against = "" if summary.against_nearest is None else summary.against_nearest
    return (
        name,
        summary.score,
        against,
        _known(summary.diversity),
        _known(summary.energy),
        f"{summary.milliseconds:.1f}",
    )


def measure_table(found: dict[str, Summary], floor: dict[str, float]) -> str:
    """Every measure by itself, with its floor."""
    head = ("measure", "floor", *found)
    rows = [
        (f"{name} [{UNITS[name]}]" if name in UNITS else name, f"{floor[name]:.3f}",
         *(summary.measures[name] for summary in found.values()))
        for name in MEASURES
    ]  # fmt: skip
    return table(head, rows)


def more_table(found: dict[str, Summary], truth: dict[str, float]) -> str:
    """What is no distance to a single collision."""
    head = (
        "source", "bias of the count", "count rises with impulse", "sensitivity to the hit",
        "volumes: KS to simulation", "volumes: KS to Mott", "stages [ms]",
    )  # fmt: skip
    rows = [("simulation", "", _number(truth["rising"]), _number(truth["sensitivity"]), "", _number(truth["mott"]), "")]
    for name, summary in found.items():
        stages = ", ".join(f"{stage} {time:.1f}" for stage, time in summary.stages.items())
        bias = Interval(*(100 * value for value in asdict(summary.bias).values()))
        rows.append((
            name, f"{bias.value:+.0f} % ({bias.low:+.0f} to {bias.high:+.0f})", str(summary.rising),
            _number(summary.sensitivity), _number(summary.volumes), _number(summary.mott), stages,
        ))  # fmt: skip
    return table(head, rows)


def table(head: Sequence[Any], rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def _known(interval: Interval) -> str:
    return "" if math.isnan(interval.value) else str(interval)


def _plain(value: Any) -> Any:
    """NaN, which JSON does not have, as null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def _write(path: Path, text: str) -> None:
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
