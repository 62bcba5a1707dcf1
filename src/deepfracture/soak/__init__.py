"""Soak test: thousands of random hits, each checked (`deepfracture soak`)."""

from deepfracture.soak.plan import Case, SoakOptions, case, first_cases
from deepfracture.soak.results import Results, summary
from deepfracture.soak.run import soak

__all__ = ["Case", "Results", "SoakOptions", "case", "first_cases", "soak", "summary"]
