"""Learning data: throw balls, simulate what breaks, keep it where interruption and company do no harm."""

from deepfracture.dataset.convert import convert
from deepfracture.dataset.executors import EXECUTORS, Executor, Local, OnRay, executor_named
from deepfracture.dataset.generate import simulate_collisions
from deepfracture.dataset.guard import Collide, Outcome
from deepfracture.dataset.store import Dataset, Sample, open_dataset, verified

__all__ = [
    "EXECUTORS",
    "Collide",
    "Dataset",
    "Executor",
    "Local",
    "OnRay",
    "Outcome",
    "Sample",
    "convert",
    "executor_named",
    "open_dataset",
    "simulate_collisions",
    "verified",
]
