"""Breakers: physics, a network and baselines behind one seam, `(Shape, Impact, rng) -> Fragments | None`."""

from deepfracture.breakers.base import PatternBreaker, PatternSource
from deepfracture.breakers.choose import AGAIN, BREAKERS, make_breaker, make_source, recall, ways

__all__ = ["AGAIN", "BREAKERS", "PatternBreaker", "PatternSource", "make_breaker", "make_source", "recall", "ways"]
