"""Rigid bodies that collide, break and come to rest: Scene, Breaker -> Recording."""

from deepfracture.world.engine import ENGINES, Motion
from deepfracture.world.learning import KINDS, draw_scene, learning_scene
from deepfracture.world.live import Collision, Live, Outcome
from deepfracture.world.recorder import Pose
from deepfracture.world.scene import (
    GRAVITY,
    STEEL,
    UPRIGHT,
    Ball,
    Block,
    Floor,
    Placed,
    Scene,
    load_scene,
    save_scene,
    standing,
    throw_scene,
)
from deepfracture.world.simulate import first_impact, joint_impact, simulate

__all__ = [
    "ENGINES",
    "GRAVITY",
    "KINDS",
    "STEEL",
    "UPRIGHT",
    "Ball",
    "Block",
    "Collision",
    "Floor",
    "Live",
    "Motion",
    "Outcome",
    "Placed",
    "Pose",
    "Scene",
    "draw_scene",
    "first_impact",
    "joint_impact",
    "learning_scene",
    "load_scene",
    "save_scene",
    "simulate",
    "standing",
    "throw_scene",
]
