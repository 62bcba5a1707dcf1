"""Options are changed by name: an unknown one is met with the near one, a deprecated one still works."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from deepfracture.runtime.options import with_changes
from deepfracture.types import BadInput


@dataclass(frozen=True)
class Options:
    speed: float = 9.0
    max_faces: int | None = None


def test_fields_are_replaced_by_name() -> None:
    assert with_changes(Options(), {"speed": 12.0}) == Options(speed=12.0)
    assert with_changes(Options(1.0), {}) == Options(1.0)


def test_an_unknown_option_is_met_with_the_near_one() -> None:
    with pytest.raises(BadInput, match=r"no option 'sped'; the options are speed, max_faces; did you mean 'speed'\?"):
        with_changes(Options(), {"sped": 1})


def test_a_deprecated_option_works_with_one_warning() -> None:
    with pytest.warns(DeprecationWarning, match="budget is deprecated, use max_faces") as caught:
        assert with_changes(Options(), {"budget": 300}, renamed={"budget": "max_faces"}) == Options(max_faces=300)
    assert len(caught) == 1
