"""Who lies still. Piles of rigid bodies never do by velocity alone: engines make them shiver."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import Floats
from deepfracture.world.engine import Motion

SHIFT, TURN, REST_TIME = 0.03, 0.06, 0.5
"""A body that stays this close to where it was [m, rad] for this long has come to rest [s] ..."""
PATIENCE = ((SHIFT, TURN, REST_TIME), (0.1, 0.3, 1.5))
"""... or one that has rocked about in a little more room for longer. It wakes when something moves it further."""


_LIMITS = tuple((shift**2, math.cos(turn / 2), patience - 1e-9) for shift, turn, patience in PATIENCE)
"""Squared distance, cosine of half the angle, time."""


@dataclass(eq=False)
class _Anchor:
    centre: Floats
    quat: Floats
    age: float


class Rest:
    """Remembers where each body was when it last moved noticeably."""

    def __init__(self) -> None:
        self._anchors: dict[tuple[int, int], _Anchor] = {}

    def update(self, body: int, motion: Motion, centre: Floats, dt: float) -> bool:
        """Whether the body rests, `dt` after it was last asked about; `centre` of mass in its mesh frame."""
        here, quat = motion.position + rotation_matrix(motion.quat_wxyz) @ centre, motion.quat_wxyz
        rests = False
        for level, (shift, turn, patience) in enumerate(_LIMITS):
            anchor = self._anchors.get((body, level))
            if anchor is None or _square(here - anchor.centre) > shift or abs(anchor.quat @ quat) < turn:
                anchor = self._anchors[body, level] = _Anchor(here, quat, -dt)
            anchor.age += dt
            rests |= anchor.age > patience
        return rests


def _square(vector: Floats) -> float:
    return float(vector @ vector)
