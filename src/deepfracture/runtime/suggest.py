"""Suggestions for misspelt names."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

CUTOFF = 0.6
"""Lowest similarity ratio (difflib): a transposition in a word of four has 0.75, two unrelated words rarely 0.5."""

LONGEST = 60
"""Characters of a word that are compared."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Suffix for a message about an unknown `word`: "; did you mean 'pot'?", or empty if no known one is close."""
    names = {name.lower(): name for name in known}
    close = get_close_matches(word.strip().lower()[:LONGEST], names, n=1, cutoff=CUTOFF)
    return f"; did you mean {names[close[0]]!r}?" if close else ""
