"""Random scenes in which a shape is hit, as varied as those of users."""

from __future__ import annotations

import numpy as np

from deepfracture.breakers import REFRACTURING
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.types import Floats, Shape
from deepfracture.world import GRAVITY, STEEL, UPRIGHT, Ball, Floor, Placed, Scene, place_on_floor

FLOOR_SHARE = 0.75
"""Share of the scenes with a floor; the others are weightless, where balls come from below as well."""
FALL_SHARE = 0.2
"""Share of the scenes with a floor in which the shape falls, spinning, mostly without a ball."""
SECOND_SHARE = 0.3
"""Share of the scenes with a ball in which a second one follows."""
AGAIN_SHARE = 0.3
"""Of the scenes whose breaker can: fragments may break again."""
SETTLE = (0.4, 1.6)
"""Shortest and longest simulated time after the last ball or body arrives [s]."""
SPEEDS = (2.0, 60.0)
"""Slowest and fastest ball [m/s], uniform in the logarithm: most hits are those that just break something."""
RADII = (0.05, 0.5)
"""Smallest and largest ball [m], uniform in the logarithm."""
FALLS = (2.0, 15.0)
"""Slowest and fastest falling shape [m/s]."""
CLEAR = 0.05
"""Free way between a ball and the sphere around the shape at the start [m]."""


def draw_scene(
    source: str, shape: Shape, rng: np.random.Generator, *, material: str, breaker: str, engine: str
) -> Scene:
    """A scene in which the shape is hit.

    It stands, falls or floats in any orientation; a ball of any size and speed comes from anywhere above the floor
    towards a random point of its surface, perhaps followed by another; fragments may break again."""
    floor = bool(rng.random() < FLOOR_SHARE)
    falls = floor and bool(rng.random() < FALL_SHARE)
    quat = _rotation(rng) if rng.random() < 0.6 else UPRIGHT[str(rng.choice(["x", "y", "z"]))]
    placed = place_on_floor(source, shape, material=material, quat_wxyz=quat)
    if falls:
        speed, spin = float(rng.uniform(*FALLS)), rng.normal(0, 3, 3)
        rise = placed.position[2] + float(rng.uniform(0.05, 0.3)) + 0.5
        placed = Placed(source, material, (0, 0, rise), quat, (*rng.normal(0, 1, 2), -speed), _tuple(spin))
    balls = [] if falls and rng.random() < 0.7 else [_ball(shape, placed, rng, floor=floor, delay=0.0)]
    if balls and rng.random() < SECOND_SHARE:
        balls.append(_ball(shape, placed, rng, floor=floor, delay=float(rng.uniform(0.0, 0.6))))
    flight = max((ball.delay + _flight(ball) for ball in balls), default=0.5)
    again = breaker in REFRACTURING and bool(rng.random() < AGAIN_SHARE * (0.3 if breaker == "physical" else 1.0))
    anything = breaker != "physical" and bool(rng.random() < 0.5)
    return Scene(
        (placed,), tuple(balls), Floor() if floor else None, gravity=GRAVITY if floor else 0.0,
        duration=flight + float(rng.uniform(*SETTLE)), engine=engine, breaker=breaker,
        impulse_fraction=float(rng.choice([0.0, 0.3, 1.0])), refracture=int(rng.integers(1, 4)) if again else 0,
        refracture_by="anything" if anything else "balls",
    )  # fmt: skip


def _ball(shape: Shape, placed: Placed, rng: np.random.Generator, *, floor: bool, delay: float) -> Ball:
    """A ball whose path leads through a random point of the surface, with compensation of gravity."""
    radius, speed = (float(np.exp(rng.uniform(*np.log(limits)))) for limits in (RADII, SPEEDS))
    goal = np.array(placed.position) + rotation_matrix(np.array(placed.quat_wxyz)) @ _surface_point(shape, rng)
    outwards = rng.normal(size=3)
    outwards /= np.linalg.norm(outwards)
    if floor:
        outwards[2] = abs(outwards[2])
    reach = 2 * float(np.linalg.norm(shape.mesh.vertices, axis=1).max()) + radius + CLEAR
    start = goal + reach * outwards
    velocity = -speed * outwards
    if floor:
        velocity[2] += GRAVITY * reach / speed / 2
        start[2] = max(start[2], radius + 0.01)
    return Ball(radius, STEEL, _tuple(start), _tuple(velocity), delay=delay)


def _flight(ball: Ball) -> float:
    """Time of flight to the middle of the scene [s]."""
    return float(np.linalg.norm(ball.position) / np.linalg.norm(ball.velocity))


def _surface_point(shape: Shape, rng: np.random.Generator) -> Floats:
    """Uniform over the surface, shape (3,)."""
    size = np.linalg.norm(shape.mesh.area_vectors, axis=1)
    a, b, c = shape.mesh.triangles[rng.choice(len(size), p=size / size.sum())]
    u, v = rng.uniform(size=2)
    u, v = (1 - u, 1 - v) if u + v > 1 else (u, v)
    return a + u * (b - a) + v * (c - a)


def _rotation(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Uniform (w, x, y, z)."""
    quat = rng.normal(size=4)
    w, x, y, z = (float(value) for value in quat / np.linalg.norm(quat))
    return w, x, y, z


def _tuple(vector: Floats) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z
