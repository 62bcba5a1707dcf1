"""Physics against closed forms: cases whose answer is known, and the table that they make."""

from deepfracture.validation.draw import draw
from deepfracture.validation.report import Curve, Finding, Plot, Report
from deepfracture.validation.suite import CASES, Case, Outcome, outcomes

__all__ = ["CASES", "Case", "Curve", "Finding", "Outcome", "Plot", "Report", "draw", "outcomes"]
