"""Physics against closed forms: cases whose answer is known, and the table that they make."""

from deepfracture.validation.draw import draw
from deepfracture.validation.report import Curve, Finding, Plot, Report
from deepfracture.validation.suite import CASES, Case, CaseResult, run_cases

__all__ = ["CASES", "Case", "CaseResult", "Curve", "Finding", "Plot", "Report", "draw", "run_cases"]
