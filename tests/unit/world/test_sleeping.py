"""Coming to rest: by place, not by speed."""

from __future__ import annotations

import numpy as np

from deepfracture.world.engine import BodyState
from deepfracture.world.sleeping import SLEEP_DISTANCE, SLEEP_TIME, SleepTracker

DT = 1 / 60
FRAMES = int(np.ceil(SLEEP_TIME / DT))


def _at(x: float, angle: float = 0.0, speed: float = 0.0) -> BodyState:
    quat = np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])
    return BodyState(np.array([x, 0, 0]), quat, np.array([speed, 0, 0]), np.zeros(3))


def _ask(rest: SleepTracker, motions: list[BodyState], centre: tuple[float, float, float] = (0, 0, 0)) -> list[bool]:
    return [rest.update(1, motion, np.array(centre), DT) for motion in motions]


def test_what_stays_rests_after_a_while() -> None:
    answers = _ask(SleepTracker(), [_at(0.0)] * (FRAMES + 1))
    assert answers == [False] * FRAMES + [True]


def test_a_shiver_is_rest_whatever_its_speed() -> None:
    shivers = [_at((-1) ** i * SLEEP_DISTANCE / 4, speed=1.0) for i in range(FRAMES + 1)]
    assert _ask(SleepTracker(), shivers)[-1]


def test_a_slow_creep_is_not_rest() -> None:
    creep = [_at(i * 2 * SLEEP_DISTANCE / FRAMES) for i in range(8 * FRAMES)]
    assert not any(_ask(SleepTracker(), creep))


def test_rocking_in_place_is_rest_in_the_end() -> None:
    rocking = [_at(0.04 * (i // 6 % 2)) for i in range(120)]
    answers = _ask(SleepTracker(), rocking)
    assert not any(answers[:FRAMES])
    assert answers[-1]


def test_turning_on_the_spot_is_not_rest() -> None:
    assert not any(_ask(SleepTracker(), [_at(0.0, 0.02 * i) for i in range(3 * FRAMES)]))


def test_what_is_moved_wakes_up() -> None:
    rest = SleepTracker()
    assert _ask(rest, [_at(0.0)] * (FRAMES + 1))[-1]
    assert _ask(rest, [_at(2 * SLEEP_DISTANCE)]) == [False]
