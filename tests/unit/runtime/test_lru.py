"""Least-recently-used values."""

import pytest

from deepfracture.runtime.lru import LRU


def test_the_least_recently_used_value_goes() -> None:
    kept: LRU[str, int] = LRU(2)
    made: list[str] = []

    def get(key: str) -> int:
        def make() -> int:
            made.append(key)
            return len(made)

        return kept.get(key, make)

    assert [get("a"), get("b"), get("a")] == [1, 2, 1]
    assert get("c") == 3  # b was used least recently
    assert [get("a"), get("c"), get("b")] == [1, 3, 4]
    assert made == ["a", "b", "c", "b"]
    assert len(kept) == 2


def test_none_is_a_value_and_a_failure_is_not_kept() -> None:
    kept: LRU[int, None] = LRU(1)
    calls: list[int] = []
    for _ in range(2):
        kept.get(1, lambda: calls.append(1))
    with pytest.raises(ZeroDivisionError):
        kept.get(2, lambda: 1 / 0)  # type: ignore[arg-type, return-value]
    kept.get(1, lambda: calls.append(1))
    assert calls == [1]
