"""Held-out collisions must not be in the training data."""

from __future__ import annotations

import numpy as np

from deepfracture.dataset import Dataset
from deepfracture.types import BadInput, Impact

SCENE = ("seed", "speed_range", "scene")
"""Settings that together determine which balls are thrown."""


def refuse_overlap(held: Dataset, train: Dataset) -> None:
    """Check that `train` can teach about the shape of `held` and holds none of its collisions.

    Raises:
        BadInput: In one line: another shape or resolution, the same balls, or a collision that is in both.
    """
    mine, other = held.settings, train.settings
    if not np.array_equal(mine.shape.mesh.vertices, other.shape.mesh.vertices):
        raise BadInput(f"{train.path}: made for another shape ({other.shape.name}), not for {mine.shape.name}")
    if mine.resolution != other.resolution:
        raise BadInput(
            f"{train.path}: at r = {other.resolution}, but {held.path} at r = {mine.resolution}; simulate one of them "
            "anew"
        )
    if all(getattr(mine, name) == getattr(other, name) for name in SCENE):
        raise BadInput(
            f"{train.path}: same seed ({mine.seed}), scene and speeds as {held.path}, so the same collisions: "
            "simulate the held-out ones with another --seed"
        )
    known = {_balls(impact) for impact in train.impacts()}
    both = sum(_balls(held_out) in known for held_out in held.impacts())
    if both:
        raise BadInput(
            f"{train.path}: holds {both} of the patterns' collisions in {held.path}; held-out collisions must not be "
            "trained on: simulate others with another --seed"
        )


def _balls(impact: Impact) -> tuple[float, ...]:
    return (*impact.position.ravel().tolist(), *impact.magnitude.tolist())
