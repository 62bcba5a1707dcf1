"""Options are frozen dataclasses: the command line reads their fields, Python callers change them by name."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


def with_changes(options: T, changes: Mapping[str, Any], *, renamed: Mapping[str, str] | None = None) -> T:
    """`options` with the fields that `changes` names replaced.

    Args:
        options: A frozen dataclass.
        changes: Values by field.
        renamed: Deprecated names and what to use instead; they work, with a `DeprecationWarning` for the caller of
            the function that calls this one.

    Raises:
        BadInput: There is no such field; names the closest one.
    """
    known, found = [field.name for field in fields(options)], {}
    for given, value in changes.items():
        name = (renamed or {}).get(given, given)
        if name not in known:
            raise BadInput(f"no option {given!r}; the options are {', '.join(known)}{did_you_mean(given, known)}")
        if name != given:
            warnings.warn(f"{given} is deprecated, use {name}", DeprecationWarning, stacklevel=3)
        found[name] = value
    return replace(options, **found)
