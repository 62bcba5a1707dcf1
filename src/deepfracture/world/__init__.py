"""Rigid bodies that collide, break and come to rest: Scene, Breaker -> Recording."""

from deepfracture.world.engine import ENGINES, Motion
from deepfracture.world.scene import (
    Ball,
    Floor,
    Placed,
    Scene,
    learning_scene,
    load_scene,
    save_scene,
    throw_scene,
)
from deepfracture.world.simulate import Collision, Outcome, first_impact, simulate

__all__ = [
    "ENGINES",
    "Ball",
    "Collision",
    "Floor",
    "Motion",
    "Outcome",
    "Placed",
    "Scene",
    "first_impact",
    "learning_scene",
    "load_scene",
    "save_scene",
    "simulate",
    "throw_scene",
]
