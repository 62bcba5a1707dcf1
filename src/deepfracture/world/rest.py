"""Who lies still. Piles of rigid bodies never do by velocity alone: engines make them shiver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.types import Floats
from deepfracture.world.engine import Motion, rotation

SHIFT, TURN = 0.03, 0.06
"""A body that stays this close to where it was [m, rad] ..."""
REST_TIME = 0.5
"""... for this long has come to rest [s]. It wakes when something moves it further."""


@dataclass(frozen=True, eq=False)
class _Anchor:
    centre: Floats
    quat: Floats
    age: float


class Rest:
    """Remembers where each body was when it last moved noticeably."""

    def __init__(self) -> None:
        self._anchors: dict[int, _Anchor] = {}

    def update(self, body: int, motion: Motion, centre: Floats, dt: float) -> bool:
        """Whether the body rests, `dt` after it was last asked about; `centre` of mass in its mesh frame."""
        here = motion.position + rotation(motion.quat_wxyz) @ centre
        anchor = self._anchors.get(body)
        if anchor is None or _moved(anchor, here, motion.quat_wxyz):
            self._anchors[body] = _Anchor(here, motion.quat_wxyz, 0.0)
            return False
        self._anchors[body] = _Anchor(anchor.centre, anchor.quat, anchor.age + dt)
        return anchor.age + dt > REST_TIME - 1e-9


def _moved(anchor: _Anchor, centre: Floats, quat: Floats) -> bool:
    turned = 2 * np.arccos(min(abs(float(anchor.quat @ quat)), 1.0))
    return bool(np.linalg.norm(centre - anchor.centre) > SHIFT or turned > TURN)
