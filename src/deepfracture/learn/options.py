"""Options of a training run, for the command line and for Python."""

from __future__ import annotations

from dataclasses import dataclass

OURS = "waves"
"""The preset of the project's own network."""
PRESETS = (OURS, "paper", "mlp", "pix2pix")


@dataclass(frozen=True)
class TrainOptions:
    """What to train, for how long, and where."""

    preset: str = OURS
    """waves (random Fourier features), or a network that predicts the distance field itself: paper, mlp or pix2pix."""
    width: float = 1.0
    """Channels of those networks, relative to their publications'."""
    features: int = 1
    """Strongest impulses of a collision that the model sees, 1 or 2."""
    epochs: int | None = None
    """Passes over the data (default: 400 for waves, the paper's 1000 for the others)."""
    minutes: float | None = None
    """Train for this many minutes instead."""
    device: str = "auto"
    """auto, cpu, cuda or mps."""
    seed: int = 0
    """Of the initial weights and the order of samples."""
