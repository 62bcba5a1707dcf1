"""What a training leaves beside its weights: the curve, and a card for people."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

from deepfracture.dataset import Dataset
from deepfracture.learn.partition.config import Config
from deepfracture.learn.reconstruction import Recall
from deepfracture.runtime.files import atomic_file

COLUMNS = ("epoch", "seconds", "loss", "learning_rate", "count_error", "bits", "ceiling", "l2")


@dataclass(frozen=True)
class Point:
    """One moment of a training."""

    epoch: int
    seconds: float
    """Time spent in training so far."""
    loss: float
    """Mean cross-entropy of the last epoch [nats]."""
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
            f"epoch {self.epoch}, {self.seconds:.0f} s: loss {self.loss:.4f}, memory {self.bits:.2f} bits "
            f"(ceiling {self.ceiling:.2f}), fragment count off by {100 * self.count_error:.0f} %"
        )


@dataclass(frozen=True)
class Card:
    """A finished training."""

    path: Path
    """The model."""
    last: Point
    recall: Recall
    text: str

    def __str__(self) -> str:
        return f"{self.path}: {self.last}"


def write_curve(folder: Path, points: list[Point]) -> None:
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
    left.semilogy(seconds, [point.loss for point in points], marker=".")
    left.set(xlabel="seconds", ylabel="cross-entropy [nats]")
    right.plot(seconds, [point.bits for point in points], marker=".", label="memory")
    right.plot(seconds, [point.ceiling for point in points], "--", label="ceiling")
    right.plot(seconds, [point.count_error for point in points], marker=".", label="fragment count, relative error")
    right.set(xlabel="seconds", ylabel="variation of information [bits]", ylim=(0, None))
    right.legend()
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=120)
    replace_file(folder / "curve.png", image.getvalue())


def card_text(dataset: Dataset, config: Config, command: str, seed: int, size: int, last: Point, found: Recall) -> str:
    """The text beside the weights."""
    settings = dataset.settings
    slow, fast = settings.speed_range
    rows = [f"  {true:5d} {exact:8d} {decoded:8d}" for true, exact, decoded in found.counts]
    return "\n".join(
        [
            f"Model of {settings.shape.name} at r = {settings.resolution}",
            "",
            f"data      deepfracture simulate {settings.shape.name} --collisions {dataset.tried} --material "
            f"{settings.material.name} --resolution {settings.resolution} --speed {slow:g} {fast:g} "
            f"--scene {settings.scene} --seed {settings.seed}",
            f"          {len(dataset)} patterns, {dataset.unbroken} collisions broke nothing, "
            f"I_max {dataset.max_impulse:.1f} N s",
            f"training  {command}",
            f"          seed {seed}, {last.epoch} epochs, {last.seconds:.0f} s, {config}",
            f"weights   {size / 1e6:.2f} MB",
            f"loss      {last.loss:.4f} nats (cross-entropy), L2 of the GS-SDF {found.error:.2e} m^2",
            f"memory    {found.bits:.3f} bits between training patterns and their decoded, segmented selves; "
            f"{found.ceiling:.3f} for the exact field (ceiling)",
            "",
            f"Fragments of {len(rows)} training patterns (mean error {100 * found.count_error:.1f} %):",
            "   true    exact  decoded",
            *rows,
            "",
        ]
    )


def replace_file(path: Path, content: bytes) -> None:
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)


def write_card(path: Path, text: str) -> None:
    """Store the card."""
    replace_file(path, text.encode())
