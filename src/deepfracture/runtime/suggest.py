"""Help for a word that is spelt nearly right."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

ALIKE = 0.6
"""Least share of letters in common: a transposition in a word of four has 0.75, two unlike words rarely 0.5."""

LONGEST = 60
"""Letters of a word that are looked at."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """What to add to a message about an unknown `word`: "; did you mean 'pot'?", or nothing if none is near."""
    names = {name.lower(): name for name in known}
    near = get_close_matches(word.strip().lower()[:LONGEST], names, n=1, cutoff=ALIKE)
    return f"; did you mean {names[near[0]]!r}?" if near else ""
