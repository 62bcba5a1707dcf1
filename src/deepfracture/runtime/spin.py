"""Waiting without falling asleep: who sleeps comes a tenth of a millisecond after what wakes it."""

from __future__ import annotations

from typing import Any

from numba import njit, types
from numba.extending import intrinsic


@intrinsic
def _value(_: Any, array: Any) -> Any:
    """The first of some int64 as it is in memory now, whichever thread has written it."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.load_atomic(data, "acquire", 8)

    return types.int64(array), generate


@njit(cache=True, nogil=True)
def spin_until(flag, value, turns):
    """Wait until flag[0] is `value`, for so many turns of a loop, less than a nanosecond each. Whether it is."""
    turn = 0
    while turn < turns and _value(flag) != value:  # pyright: ignore[reportCallIssue]
        turn += 1
    return turn < turns


@njit(cache=True, nogil=True)
def spin_until_zero(flags, turns):
    """Wait until all flags are zero, one after another, for so many turns each. Whether they are."""
    n = 0
    while n < len(flags) and spin_until(flags[n:], 0, turns):
        n += 1
    return n == len(flags)
