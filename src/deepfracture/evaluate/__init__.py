"""How good any way of breaking is on held-out collisions, in units of chaos itself."""

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
