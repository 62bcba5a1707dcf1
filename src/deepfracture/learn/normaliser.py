"""The one place where an impact becomes the network's input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.types import BadInput, Floats, Impact


@dataclass(frozen=True)
class Normaliser:
    """J^norm of the paper: [p d I] of the strongest impulses, in [-1, 1]^7 each."""

    max_impulse: float
    """I_max: the strongest impulse of the training data [N s]."""
    features: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.max_impulse < np.inf or self.features < 1:
            raise BadInput(f"max_impulse and features must be positive, got {self.max_impulse}, {self.features}")

    def __call__(self, impact: Impact) -> Floats:
        """Rows [p, d, 2 I / I_max - 1], shape (features, 7).

        Positions are in [-1, 1] already, since bodies fill that box; rounding at its border and impulses
        beyond I_max are clipped. Rows that the impact has no impulse for are those of an impulse of
        no strength: zeros, and -1."""
        rows = np.zeros((self.features, 7))
        rows[:, 6] = -1
        k = min(self.features, len(impact.magnitude))
        rows[:k, :3] = impact.position[:k]
        rows[:k, 3:6] = impact.direction[:k]
        rows[:k, 6] = 2 * impact.magnitude[:k] / self.max_impulse - 1
        return np.clip(rows, -1, 1)


def normalise_impact(impact: Impact, max_impulse: float) -> Floats:
    """The strongest impulse alone, shape (7,)."""
    return Normaliser(max_impulse)(impact)[0]
