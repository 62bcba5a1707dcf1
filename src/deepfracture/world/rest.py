"""Who lies still. Piles of rigid bodies never do by velocity alone: engines make them shiver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepfracture.types import Floats
from deepfracture.world.engine import Motion, rotation

SHIFT, TURN, REST_TIME = 0.03, 0.06, 0.5
"""A body that stays this close to where it was [m, rad] for this long has come to rest [s] ..."""
PATIENCE = ((SHIFT, TURN, REST_TIME), (0.1, 0.3, 1.5))
"""... or one that has rocked about in a little more room for longer. It wakes when something moves it further."""


@dataclass(frozen=True, eq=False)
class _Anchor:
    centre: Floats
    quat: Floats
    age: float

    def left(self, centre: Floats, quat: Floats, shift: float, turn: float) -> bool:
        turned = 2 * np.arccos(min(abs(float(self.quat @ quat)), 1.0))
        return bool(np.linalg.norm(centre - self.centre) > shift or turned > turn)


class Rest:
    """Remembers where each body was when it last moved noticeably."""

    def __init__(self) -> None:
        self._anchors: dict[tuple[int, int], _Anchor] = {}

    def update(self, body: int, motion: Motion, centre: Floats, dt: float) -> bool:
        """Whether the body rests, `dt` after it was last asked about; `centre` of mass in its mesh frame."""
        here = motion.position + rotation(motion.quat_wxyz) @ centre
        rests = False
        for level, (shift, turn, patience) in enumerate(PATIENCE):
            anchor = self._anchors.get((body, level))
            if anchor is None or anchor.left(here, motion.quat_wxyz, shift, turn):
                anchor = _Anchor(here, motion.quat_wxyz, -dt)
            self._anchors[body, level] = _Anchor(anchor.centre, anchor.quat, anchor.age + dt)
            rests |= anchor.age + dt > patience - 1e-9
        return rests
