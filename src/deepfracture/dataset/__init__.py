"""Training data: simulate random collisions and store them, safe against kills and concurrent writers."""

from deepfracture.dataset.copy import copy_dataset
from deepfracture.dataset.dataset import Dataset, open_dataset, verify_dataset
from deepfracture.dataset.entries import Sample, recorded, write_sample, write_unbroken
from deepfracture.dataset.executors import EXECUTORS, Executor, Local, RayCluster, make_executor
from deepfracture.dataset.generate import simulate_collisions
from deepfracture.dataset.options import SimulateOptions
from deepfracture.dataset.settings import DatasetSettings, create_dataset
from deepfracture.dataset.watchdog import CollisionResult, Simulator

__all__ = [
    "EXECUTORS",
    "CollisionResult",
    "Dataset",
    "DatasetSettings",
    "Executor",
    "Local",
    "RayCluster",
    "Sample",
    "SimulateOptions",
    "Simulator",
    "copy_dataset",
    "create_dataset",
    "make_executor",
    "open_dataset",
    "recorded",
    "simulate_collisions",
    "verify_dataset",
    "write_sample",
    "write_unbroken",
]
