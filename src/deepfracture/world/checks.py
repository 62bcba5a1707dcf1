"""Checks of the fields of a scene. Each raises `BadInput`, which begins with the name of the field."""

from __future__ import annotations

import reprlib
import sys
from typing import Any

import numpy as np

from deepfracture.types import BadInput


def _is_finite(value: Any) -> bool:
    """Whether it is a number that a float can hold."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def shortened(value: Any) -> str:
    """A value in a message, abbreviated where it is long."""
    return _short.repr(value)


class _Short(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        """Python refuses to spell out integers of thousands of digits."""
        return repr(x) if x.bit_length() < 200 else f"an integer of {x.bit_length()} bits"


_short = _Short()
_short.maxstring = _short.maxother = 60


def check_numbers(record: Any, *names: str) -> None:
    for name in names:
        value = getattr(record, name)
        if not _is_finite(value):
            raise BadInput(f"{name} must be a finite number, got {shortened(value)}")


def check_positive(record: Any, *names: str) -> None:
    check_numbers(record, *names)
    for name in names:
        if not getattr(record, name) > 0:
            raise BadInput(f"{name} must be positive, got {getattr(record, name)}")


def check_at_least_zero(record: Any, *names: str) -> None:
    check_numbers(record, *names)
    for name in names:
        if not getattr(record, name) >= 0:
            raise BadInput(f"{name} must be zero or more, got {getattr(record, name)}")


def check_whole(record: Any, *names: str) -> None:
    for name in names:
        value = getattr(record, name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 64:
            raise BadInput(f"{name} must be a whole number, zero or more and less than 2^64, got {shortened(value)}")


def check_unit_quaternion(record: Any) -> None:
    if abs(np.linalg.norm(record.quat_wxyz) - 1) > 1e-3:
        raise BadInput(f"quat_wxyz must have length 1, got {list(record.quat_wxyz)}")


def check_text(record: Any, *names: str) -> None:
    for name in names:
        if not isinstance(getattr(record, name), str) or not getattr(record, name):
            raise BadInput(f"{name} must be text, got {shortened(getattr(record, name))}")


def check_vectors(record: Any, **lengths: int) -> None:
    for name, length in lengths.items():
        value = getattr(record, name)
        good = isinstance(value, tuple | list) and len(value) == length
        if not good or not all(_is_finite(v) for v in value):
            raise BadInput(f"{name} must be {length} finite numbers, got {shortened(value)}")
        object.__setattr__(record, name, tuple(float(v) for v in value))
