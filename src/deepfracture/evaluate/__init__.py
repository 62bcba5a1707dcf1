"""Accuracy of breakers on held-out collisions, normalised by simulation-to-simulation variability."""

from deepfracture.evaluate.evaluation import Evaluation, evaluate, load_evaluation
from deepfracture.evaluate.overlap import refuse_overlap
from deepfracture.evaluate.report import write_report
from deepfracture.evaluate.summary import Interval, Summary, score_samples, summarise

__all__ = [
    "Evaluation",
    "Interval",
    "Summary",
    "evaluate",
    "load_evaluation",
    "refuse_overlap",
    "score_samples",
    "summarise",
    "write_report",
]
