"""Thousands of random hits, each checked: `deepfracture soak`."""

from .plan import Case, Settings, case, numbered
from .results import Results, summary
from .run import soak

__all__ = ["Case", "Results", "Settings", "case", "numbered", "soak", "summary"]
