"""Thousands of random hits, each checked: `deepfracture soak`."""

from deepfracture.soak.plan import Case, Settings, case, numbered
from deepfracture.soak.results import Results, summary
from deepfracture.soak.run import soak

__all__ = ["Case", "Results", "Settings", "case", "numbered", "soak", "summary"]
