"""Which bodies are at rest. Velocity alone does not tell in a pile of rigid bodies: engines make them jitter."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import Floats
from deepfracture.world.engine import BodyState

SLEEP_DISTANCE, SLEEP_ANGLE, SLEEP_TIME = 0.03, 0.06, 0.5
"""A body that stays this close to where it was [m, rad] for this long [s] is at rest ..."""
SLEEP_LEVELS = ((SLEEP_DISTANCE, SLEEP_ANGLE, SLEEP_TIME), (0.1, 0.3, 1.5))
"""... or one that rocks within a little more room for longer. It wakes when something moves it further."""

_LIMITS = tuple((distance**2, math.cos(angle / 2), time - 1e-9) for distance, angle, time in SLEEP_LEVELS)
"""Squared distance, cosine of half the angle, time."""


@dataclass(eq=False)
class _Anchor:
    centre: Floats
    quat: Floats
    age: float


class SleepTracker:
    """Remembers where each body was when it last moved noticeably."""

    def __init__(self) -> None:
        self._anchors: dict[tuple[int, int], _Anchor] = {}

    def update(self, body: int, state: BodyState, centre: Floats, dt: float) -> bool:
        """Whether the body is at rest, `dt` [s] after the last call; `centre` of mass in its mesh frame."""
        here, quat = state.position + rotation_matrix(state.quat_wxyz) @ centre, state.quat_wxyz
        sleeping = False
        for level, (distance, cosine, time) in enumerate(_LIMITS):
            anchor = self._anchors.get((body, level))
            if anchor is None or _square(here - anchor.centre) > distance or abs(anchor.quat @ quat) < cosine:
                anchor = self._anchors[body, level] = _Anchor(here, quat, -dt)
            anchor.age += dt
            sleeping |= anchor.age > time
        return sleeping


def _square(vector: Floats) -> float:
    return float(vector @ vector)
