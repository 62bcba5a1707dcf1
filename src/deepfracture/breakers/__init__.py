"""Breakers: physics, a network and baselines behind one seam, `(Shape, Impact, rng) -> Fragments | None`."""

from typing import TYPE_CHECKING

from deepfracture.breakers.options import BREAKERS as BREAKERS
from deepfracture.breakers.options import REFRACTURING as REFRACTURING
from deepfracture.breakers.options import BreakerOptions as BreakerOptions
from deepfracture.runtime.lazy import lazy_names

if TYPE_CHECKING:
    from deepfracture.breakers.base import PatternBreaker as PatternBreaker
    from deepfracture.breakers.base import PatternSource as PatternSource
    from deepfracture.breakers.registry import ablations as ablations
    from deepfracture.breakers.registry import make_breaker as make_breaker
    from deepfracture.breakers.registry import make_source as make_source
    from deepfracture.breakers.registry import open_patterns as open_patterns

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "base": ("PatternBreaker", "PatternSource"),
        "registry": ("make_breaker", "make_source", "open_patterns", "ablations"),
    },
)
