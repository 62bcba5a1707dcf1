"""Rigid bodies that collide, break and come to rest: Scene, Breaker -> Recording."""

from deepfracture.world.engine import BodyState
from deepfracture.world.engines import ENGINES
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
    as_vector,
)
from deepfracture.world.scene_builders import place_on_floor, throw_scene
from deepfracture.world.scene_files import load_scene, save_scene
from deepfracture.world.simulate import first_impact, joint_impact, simulate
from deepfracture.world.training_scenes import KINDS, draw_scene, single_ball_scene

__all__ = [
    "ENGINES",
    "GRAVITY",
    "KINDS",
    "STEEL",
    "UPRIGHT",
    "Ball",
    "Block",
    "BodyState",
    "Collision",
    "Floor",
    "Live",
    "Outcome",
    "Placed",
    "Pose",
    "Scene",
    "as_vector",
    "draw_scene",
    "first_impact",
    "joint_impact",
    "load_scene",
    "place_on_floor",
    "save_scene",
    "simulate",
    "single_ball_scene",
    "throw_scene",
]
