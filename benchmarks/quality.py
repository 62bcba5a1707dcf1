"""Quality against time and size: what networks remember of their training patterns while they are trained.

Reads the run folders that `deepfracture train` made on one data set, whatever the preset.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import tyro
from common import ROOT, start, table, write_text

from deepfracture.runtime.files import atomic_file
from deepfracture.types import BadInput


def quality(
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
    /,
    out: Path = ROOT / "runs" / "quality",
) -> Path:
    """Draw the curves of several trainings; writes quality.md and quality.png.

    Args:
        runs: run folders, finished or not.
        out: folder for the results.
    """
    if not runs:
        raise BadInput("runs: none given; make some with deepfracture train")
    curves = {run.name: read_curve(run) for run in runs}
    sizes = {run.name: size_of(run) for run in runs}
    write_text(out / "quality.md", report(curves, sizes))
    plot(curves, sizes, out / "quality.png")
    return out / "quality.md"


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
    return f"# Quality against time and size\n\n{table(heads, rows)}\n\n![quality.png](quality.png)\n"


def plot(curves: dict[str, list[dict[str, float]]], sizes: dict[str, float], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, curve in curves.items():
        seconds = [point["seconds"] for point in curve]
        label = f"{name} ({sizes[name]:.1f} MB)"
        left.plot(seconds, [point["l2"] for point in curve], marker=".", label=label)
        right.plot(seconds, [point["bits"] - point["ceiling"] for point in curve], marker=".", label=label)
    left.set(xlabel="training [s]", ylabel="L2 of the GS-SDF [m$^2$]", yscale="log")
    right.set(xlabel="training [s]", ylabel="memory above its ceiling [bits]", ylim=(0, None))
    right.axhline(0.15, color="0.6", linewidth=0.8)
    right.legend(fontsize=8)
    with atomic_file(path) as scratch:
        figure.savefig(scratch, format="png", dpi=130)


if __name__ == "__main__":
    start(quality)
