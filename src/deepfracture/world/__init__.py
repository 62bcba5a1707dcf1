"""Rigid bodies that collide, break and come to rest: Scene, Breaker -> Recording."""

from deepfracture.world.engine import ENGINES, Motion
from deepfracture.world.learning import KINDS, draw_scene, learning_scene
from deepfracture.world.scene import (
    Ball,
    Block,
    Floor,
    Placed,
    Scene,
    load_scene,
    save_scene,
    throw_scene,
)
from deepfracture.world.simulate import Collision, Outcome, first_impact, joint_impact, simulate

__all__ = [
    "ENGINES",
    "KINDS",
    "Ball",
    "Block",
    "Collision",
    "Floor",
    "Motion",
    "Outcome",
    "Placed",
    "Scene",
    "draw_scene",
    "first_impact",
    "joint_impact",
    "learning_scene",
    "load_scene",
    "save_scene",
    "simulate",
    "throw_scene",
]
