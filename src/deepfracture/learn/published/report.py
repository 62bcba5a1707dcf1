"""What the training of a field network leaves beside its weights: the curve, and a card for people."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

from deepfracture.dataset import Dataset
from deepfracture.learn.published.config import FieldConfig
from deepfracture.learn.reconstruction import Recall
from deepfracture.learn.report import COLUMNS, Point, replace_file

STABLE = 4e-4
"""The L2 [m^2] from which the paper finds that fragments are stable (supplement)."""


@dataclass(frozen=True)
class FieldPoint(Point):
    """One moment of a training; the loss is the L2 of what was trained on, cracks weighted as asked [m^2]."""

    def __str__(self) -> str:
        return (
            f"epoch {self.epoch}, {self.seconds:.0f} s: L2 {self.loss:.2e} m^2, memory {self.bits:.2f} bits "
            f"(ceiling {self.ceiling:.2f}), fragment count off by {100 * self.count_error:.0f} %"
        )


def write_field_curve(folder: Path, points: list[FieldPoint]) -> None:
    """`curve.csv` and `curve.png`."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows(point.row for point in points)
    replace_file(folder / "curve.csv", text.getvalue().encode())

    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    seconds = [point.seconds for point in points]
    left.semilogy(seconds, [point.loss for point in points], marker=".", label="loss")
    left.semilogy(seconds, [point.l2 for point in points], marker=".", label="decoded training patterns")
    left.axhline(STABLE, color="grey", linestyle=":", label="stable, says the paper")
    left.set(xlabel="seconds", ylabel="L2 [m$^2$]")
    left.legend()
    right.plot(seconds, [point.bits for point in points], marker=".", label="memory")
    right.plot(seconds, [point.ceiling for point in points], "--", label="ceiling")
    right.plot(seconds, [point.count_error for point in points], marker=".", label="fragment count, relative error")
    right.set(xlabel="seconds", ylabel="variation of information [bits]", ylim=(0, None))
    right.legend()
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=120)
    replace_file(folder / "curve.png", image.getvalue())


def field_card(
    dataset: Dataset, config: FieldConfig, command: str, weights: int, size: int, last: Point, found: Recall
) -> str:
    """The text beside the weights."""
    settings = dataset.settings
    rows = [f"  {true:5d} {exact:8d} {decoded:8d}" for true, exact, decoded in found.counts]
    return "\n".join(
        [
            f"Field model ({config.preset}) of {settings.shape.name} at r = {settings.resolution}",
            "",
            f"data      {len(dataset)} patterns in {dataset.name}, {settings.material.name}, "
            f"seed {settings.seed}, I_max {dataset.max_impulse:.1f} N s",
            f"training  {command}",
            f"          {last.epoch} epochs, {last.seconds:.0f} s, {config}",
            f"weights   {weights / 1e6:.2f} M, {size / 1e6:.2f} MB",
            f"loss      {last.loss:.2e} m^2 (L2 in training); of decoded training patterns {found.error:.2e} m^2 "
            f"(the paper: stable from {STABLE:.0e})",
            f"memory    {found.bits:.3f} bits between training patterns and their decoded, segmented selves; "
            f"{found.ceiling:.3f} for the exact field (ceiling)",
            "",
            f"Fragments of {len(rows)} training patterns (mean error {100 * found.count_error:.1f} %):",
            "   true    exact  decoded",
            *rows,
            "",
        ]
    )
