"""Values that are costly to make, the most recently used ones kept."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class LRU(Generic[K, V]):
    """At most `size` values by key; unlike `functools.lru_cache`, each call says how its value is made.

    Keys are kept alive with their values. Not thread-safe."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._values: dict[K, V] = {}

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The value of `key`, made if it is not kept; the least recently used value beyond `size` goes."""
        value = self._values.pop(key) if key in self._values else make()
        self._values[key] = value  # the last of a dict is the most recent
        if len(self._values) > self.size:
            del self._values[next(iter(self._values))]
        return value
