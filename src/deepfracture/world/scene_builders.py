"""Builds scenes: a shape on the floor, a ball thrown at it."""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import Floats, Shape
from deepfracture.world.scene import GRAVITY, STEEL, Ball, Floor, Placed, Scene, as_vector


def place_on_floor(
    name: str,
    shape: Shape,
    *,
    material: str,
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    repair: bool = False,
) -> Placed:
    """The shape with a rotation world_from_body, a millimetre above a floor at z = 0."""
    lowest = (shape.mesh.vertices @ rotation_matrix(np.asarray(quat_wxyz, float)).T)[:, 2].min()
    return Placed(name, material, (0.0, 0.0, float(-lowest) + 1e-3), quat_wxyz, repair=repair)


def throw_scene(
    name: str,
    shape: Shape,
    rng: np.random.Generator,
    *,
    material: str,
    aim: Floats | None = None,
    direction: Floats | None = None,
    speed: float | None = None,
    radius: float = 0.2,
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    engine: str = "rapier",
    seed: int = 0,
) -> Scene:
    """The shape stands on the floor; a steel ball flies at it.

    The path of the ball goes through the point `aim` (body frame) along `direction` (world frame), at `speed` [m/s].
    What is not given is drawn from `rng`: a point near the centre, from anywhere around and slightly downwards, at 15
    to 25 m/s.
    """
    placed = place_on_floor(name, shape, material=material, quat_wxyz=quat_wxyz)
    turn, position = rotation_matrix(np.asarray(quat_wxyz, float)), np.array(placed.position)
    if aim is None:
        aim = rng.uniform(-0.15, 0.15, 3) * np.ptp(shape.mesh.bounds, axis=0)
    if direction is None:
        azimuth = rng.uniform(0, 2 * np.pi)
        direction = np.array([np.cos(azimuth), np.sin(azimuth), -0.15])
    if speed is None:
        speed = float(rng.uniform(15, 25))
    velocity = np.asarray(direction, float) / np.linalg.norm(direction) * speed
    target = position + turn @ np.asarray(aim, float)
    flight = 4.0 / speed
    start = target - velocity * flight + [0, 0, GRAVITY * flight**2 / 2]
    start[2] = max(start[2], radius + 0.01)
    ball = Ball(radius, STEEL, as_vector(start), as_vector(velocity))
    return Scene((placed,), (ball,), Floor(), duration=10.0, engine=engine, seed=seed)
