"""Requests from a browser, which threads of viser make and the thread of the world carries out."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

MAX_CLICKS = 2
"""Clicks that wait while a break is computed; more are dropped."""


@dataclass(frozen=True)
class Click:
    """A click into the scene."""

    origin: tuple[float, float, float]
    """Of its ray [m]."""
    direction: tuple[float, float, float]
    time: float
    """`time.perf_counter()`"""


class Requests:
    """The clicks and the latest request of each kind that wait. Thread-safe."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._requests: dict[str, Callable[[], None]] = {}
        self._clicks: deque[Click] = deque()
        self.stopped = False

    def add(self, kind: str, action: Callable[[], None]) -> None:
        """Request an action, instead of an earlier one of that kind that still waits."""
        with self._changed:
            self._requests[kind] = action
            self._changed.notify()

    def add_click(self, origin: tuple[float, float, float], direction: tuple[float, float, float]) -> None:
        with self._changed:
            if len(self._clicks) < MAX_CLICKS:
                self._clicks.append(Click(origin, direction, time.perf_counter()))
                self._changed.notify()

    def stop(self) -> None:
        """End the wait for good."""
        with self._changed:
            self.stopped = True
            self._changed.notify()

    def wait(self, deadline: float | None) -> bool:
        """Wait for a request or until `deadline` by `time.perf_counter()`. False once stopped."""
        with self._changed:
            while not (self.stopped or self._requests or self._clicks):
                left = None if deadline is None else deadline - time.perf_counter()
                if left is not None and left <= 0:
                    break
                self._changed.wait(left)
            return not self.stopped

    def take(self) -> tuple[list[Callable[[], None]], list[Click]]:
        """Remove and return all that wait."""
        with self._changed:
            taken = list(self._requests.values()), list(self._clicks)
            self._requests.clear()
            self._clicks.clear()
            return taken
