"""Python names that have changed: the old one works for one more release, with a warning."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


def renamed_fields(**names: str) -> Callable[[type[T]], type[T]]:
    """Class decorator for a dataclass with renamed fields, `old="new"`: the old name still works as keyword and
    attribute."""

    def decorate(cls: type[T]) -> type[T]:
        init = cls.__init__

        @functools.wraps(init)
        def renamed_init(self: Any, *args: Any, **given: Any) -> None:
            for old in [name for name in given if name in names]:
                _warn(cls, old, names[old])
                given[names[old]] = given.pop(old)
            init(self, *args, **given)

        cls.__init__ = renamed_init
        for old, new in names.items():
            setattr(cls, old, property(functools.partial(_renamed_value, old=old, new=new)))
        return cls

    return decorate


def _renamed_value(record: Any, *, old: str, new: str) -> Any:
    _warn(type(record), old, new)
    return getattr(record, new)


def _warn(cls: type, old: str, new: str) -> None:
    warnings.warn(f"{cls.__name__}.{old} is now called {new}", DeprecationWarning, stacklevel=3)
