"""Learning data: throw balls, simulate what breaks, keep it in a folder that survives interruption."""

from deepfracture.dataset.generate import Collide, Outcome, simulate_collisions
from deepfracture.dataset.store import Dataset, Sample, open_dataset

__all__ = ["Collide", "Dataset", "Outcome", "Sample", "open_dataset", "simulate_collisions"]
