"""What a training leaves beside its weights: the curve, and a model card."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepfracture.dataset import Dataset
from deepfracture.learn.reconstruction import Reconstruction
from deepfracture.runtime.files import atomic_file

COLUMNS = ("epoch", "seconds", "loss", "learning_rate", "count_error", "bits", "ceiling", "l2")
STABLE = 4e-4
"""The L2 [m^2] from which the paper finds that fragments are stable (supplement)."""


@dataclass(frozen=True)
class Objective:
    """The loss that a training minimises."""

    name: str
    unit: str


CROSS_ENTROPY, L2 = Objective("cross-entropy", "nats"), Objective("L2", "m^2")


@dataclass(frozen=True)
class CurvePoint:
    """One moment of a training."""

    epoch: int
    seconds: float
    """Time spent in training so far."""
    loss: float
    """Mean of the last epoch, in the unit of the objective."""
    learning_rate: float
    count_error: float
    bits: float
    ceiling: float
    l2: float
    """[m^2]"""

    @property
    def row(self) -> tuple[float, ...]:
        return tuple(getattr(self, name) for name in COLUMNS)

    def __str__(self) -> str:
        return (
            f"epoch {self.epoch}, {self.seconds:.0f} s: loss {self.loss:.4g}, reconstruction {self.bits:.2f} bits "
            f"(ceiling {self.ceiling:.2f}), fragment count off by {100 * self.count_error:.0f} %"
        )


@dataclass(frozen=True)
class TrainingReport:
    """A finished training."""

    path: Path
    """The model."""
    last: CurvePoint
    reconstruction: Reconstruction

    def __str__(self) -> str:
        return f"{self.path}: {self.last}"


def write_curve(folder: Path, points: list[CurvePoint], objective: Objective) -> None:
    """`curve.csv` and `curve.png`."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows(point.row for point in points)
    _write(folder / "curve.csv", text.getvalue().encode())

    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    seconds = [point.seconds for point in points]
    left.semilogy(seconds, [point.loss for point in points], marker=".", label="loss")
    if objective is L2:
        left.semilogy(seconds, [point.l2 for point in points], marker=".", label="decoded training patterns")
        left.axhline(STABLE, color="grey", linestyle=":", label="stable, according to the paper")
        left.legend()
    left.set(xlabel="seconds", ylabel=f"{objective.name} [{objective.unit.replace('^2', '$^2$')}]")
    right.plot(seconds, [point.bits for point in points], marker=".", label="reconstruction")
    right.plot(seconds, [point.ceiling for point in points], "--", label="ceiling")
    right.plot(seconds, [point.count_error for point in points], marker=".", label="fragment count, relative error")
    right.set(xlabel="seconds", ylabel="variation of information [bits]", ylim=(0, None))
    right.legend()
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=120)
    _write(folder / "curve.png", image.getvalue())


def write_card(
    path: Path, dataset: Dataset, config: Any, command: str, objective: Objective, report: TrainingReport
) -> None:
    """A description of the model for people: data, training, size, quality."""
    settings, last, found = dataset.settings, report.last, report.reconstruction
    slow, fast = settings.speed_range
    stable = f" (the paper: stable from {STABLE:.0e})" if objective is L2 else ""
    lines = [
        f"Model of {settings.shape.name} at r = {settings.resolution}",
        "",
        f"data      deepfracture simulate {settings.shape.name} --collisions {dataset.tried} --material "
        f"{settings.material.name} --resolution {settings.resolution} --speed {slow:g} {fast:g} "
        f"--scene {settings.scene} --seed {settings.seed}",
        f"          {len(dataset)} patterns, {dataset.unbroken} collisions without fracture, "
        f"I_max {dataset.max_impulse:.1f} N s",
        f"training  {command}",
        f"          {last.epoch} epochs, {last.seconds:.0f} s, {config}",
        f"weights   {report.path.stat().st_size / 1e6:.2f} MB",
        f"loss      {last.loss:.4g} {objective.unit} ({objective.name}), L2 of decoded training patterns "
        f"{found.error:.2e} m^2{stable}",
        f"quality   {found.bits:.3f} bits between training patterns and their decoded, segmented reconstructions; "
        f"{found.ceiling:.3f} for the exact field (ceiling)",
        "",
        f"Fragments of {len(found.counts)} training patterns (mean error {100 * found.count_error:.1f} %):",
        "   true    exact  decoded",
        *(f"  {true:5d} {exact:8d} {decoded:8d}" for true, exact, decoded in found.counts),
        "",
    ]
    _write(path, "\n".join(lines).encode())


def _write(path: Path, content: bytes) -> None:
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)
