"""Plots of the validation as small pictures."""

from __future__ import annotations

from pathlib import Path

from deepfracture.runtime.files import atomic_file
from deepfracture.validation.report import Plot


def draw(plot: Plot, folder: Path) -> Path:
    """Write `plot` to FOLDER/NAME.png, complete or not at all; returns its path."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4.4), dpi=90, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for curve in plot.curves:
        axes.plot(curve.x, curve.y, curve.style, label=curve.label, markersize=5 if curve.style == "." else 7)
    if plot.log:
        axes.set_xscale("log")
        axes.set_yscale("log")
    axes.set(title=plot.title, xlabel=plot.x_label, ylabel=plot.y_label)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2)  # beside the axes, so that it hides nothing
    path = folder / f"{plot.name}.png"
    with atomic_file(path) as temporary:
        figure.savefig(temporary)
    return path
