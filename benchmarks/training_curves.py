"""Quality against time and size: how well networks reconstruct their training patterns during training.

Reads the run folders that `deepfracture train` made on one data set, whatever the preset.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import tyro
from harness import ROOT, row_of_axes, save_figure, start, table, write_text

from deepfracture.types import BadInput


def training_curves(
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
    /,
    out: Path = ROOT / "runs" / "training_curves",
) -> Path:
    """Draw the curves of several trainings; writes training_curves.md and training_curves.png.

    Args:
        runs: run folders, finished or not.
        out: folder for the results.
    """
    if not runs:
        raise BadInput("runs: none given; make some with deepfracture train")
    curves = {run.name: read_curve(run) for run in runs}
    sizes = {run.name: size_of(run) for run in runs}
    write_text(out / "training_curves.md", report(curves, sizes))
    plot(curves, sizes, out / "training_curves.png")
    return out / "training_curves.md"


def read_curve(run: Path) -> list[dict[str, float]]:
    """The points of curve.csv, by column."""
    path = run / "curve.csv"
    if not path.is_file():
        raise BadInput(f"{path}: no such file; give folders made by deepfracture train")
    with path.open(newline="") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    if not rows:
        raise BadInput(f"{path}: no point yet; train longer")
    return rows


def size_of(run: Path) -> float:
    """Of the finished weights [MB]; nan before."""
    path = run / "model.safetensors"
    return path.stat().st_size / 1e6 if path.is_file() else float("nan")


def report(curves: dict[str, list[dict[str, float]]], sizes: dict[str, float]) -> str:
    """The last point of each training."""
    rows = [
        [
            name, f"{last['seconds']:.0f}", f"{last['epoch']:.0f}", f"{last['l2']:.1e}", f"{last['bits']:.2f}",
            f"{last['ceiling']:.2f}", f"{100 * last['count_error']:.0f} %", f"{sizes[name]:.1f}",
        ]
        for name, last in ((name, curve[-1]) for name, curve in curves.items())
    ]  # fmt: skip
    heads = ["run", "seconds", "epochs", "L2 [m^2]", "memory [bits]", "ceiling [bits]", "count error", "MB"]
    return f"# Quality against time and size\n\n{table(heads, rows)}\n\n![training_curves.png](training_curves.png)\n"


def plot(curves: dict[str, list[dict[str, float]]], sizes: dict[str, float], path: Path) -> None:
    figure, (left, right) = row_of_axes(2, (9, 3.6))
    for name, curve in curves.items():
        seconds = [point["seconds"] for point in curve]
        label = f"{name} ({sizes[name]:.1f} MB)"
        left.plot(seconds, [point["l2"] for point in curve], marker=".", label=label)
        right.plot(seconds, [point["bits"] - point["ceiling"] for point in curve], marker=".", label=label)
    left.set(xlabel="training [s]", ylabel="L2 of the GS-SDF [m$^2$]", yscale="log")
    right.set(xlabel="training [s]", ylabel="memory above its ceiling [bits]", ylim=(0, None))
    right.axhline(0.15, color="0.6", linewidth=0.8)
    right.legend(fontsize=8)
    save_figure(figure, path, 130)


if __name__ == "__main__":
    start(training_curves)
