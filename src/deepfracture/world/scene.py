"""Scenes: the bodies at the start, the balls that fly at them, and the world around them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from deepfracture.runtime.deprecated import renamed_fields
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, ContactMaterial
from deepfracture.world.checks import (
    check_at_least_zero,
    check_numbers,
    check_positive,
    check_text,
    check_unit_quaternion,
    check_vectors,
    check_whole,
    shortened,
)
from deepfracture.world.engines import ENGINES

Vector = tuple[float, float, float]
STEEL = 7800.0
"""Density of thrown balls [kg/m^3]."""
GRAVITY = 9.81
"""Standard gravity on Earth [m/s^2]."""
UPRIGHT = {"z": (1.0, 0.0, 0.0, 0.0), "y": (0.5**0.5, 0.5**0.5, 0.0, 0.0), "x": (0.5**0.5, 0.0, -(0.5**0.5), 0.0)}
"""Rotation (w, x, y, z) that turns this axis of the file to the world's z."""
MAX_FRAMES, MAX_STEPS = 100_000, 10_000_000
"""Of a whole scene: half an hour at 60 frames a second, eleven hours at 240 steps."""


def as_vector(values: ArrayLike) -> Vector:
    """Three numbers as a field of a scene."""
    x, y, z = (float(value) for value in np.asarray(values))
    return x, y, z


@renamed_fields(spin="angular_velocity")
@dataclass(frozen=True)
class Placed:
    """A breakable shape at the start."""

    shape: str
    """Built-in name, or a mesh file (relative to the scene's file)."""
    material: str
    position: Vector = (0.0, 0.0, 0.0)
    """Of the centre of the shape's box [m]."""
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Rotation world_from_body."""
    velocity: Vector = (0.0, 0.0, 0.0)
    """Of the centre of mass [m/s]."""
    angular_velocity: Vector = field(default=(0.0, 0.0, 0.0), metadata={"key": "spin"})
    """[rad/s]; `spin` in a scene file."""
    repair: bool = False
    """Repair an open mesh."""

    def __post_init__(self) -> None:
        check_text(self, "shape", "material")
        if not isinstance(self.repair, bool):
            raise BadInput(f"repair must be true or false, got {shortened(self.repair)}")
        check_vectors(self, position=3, quat_wxyz=4, velocity=3, angular_velocity=3)
        check_unit_quaternion(self)


@dataclass(frozen=True)
class Ball:
    """An unbreakable ball."""

    radius: float
    """[m]"""
    density: float
    """[kg/m^3]"""
    position: Vector
    """[m]"""
    velocity: Vector
    """[m/s]"""
    delay: float = 0.0
    """When it appears [s]."""

    def __post_init__(self) -> None:
        check_positive(self, "radius", "density")
        check_at_least_zero(self, "delay")
        check_vectors(self, position=3, velocity=3)

    @property
    def mass(self) -> float:
        """[kg]"""
        return self.density * 4 / 3 * np.pi * self.radius**3


@dataclass(frozen=True)
class Floor:
    """A horizontal floor."""

    height: float = 0.0
    """[m]"""
    friction: float = 0.6
    """Coulomb coefficient against everything."""

    def __post_init__(self) -> None:
        check_numbers(self, "height")
        check_at_least_zero(self, "friction")


@dataclass(frozen=True)
class Block:
    """A fixed box: an edge to break something over, a support, a wall."""

    position: Vector
    """Of its centre [m]."""
    half_sides: Vector
    """Half the length of its sides [m]."""
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Rotation world_from_block."""
    friction: float = 0.6
    """Coulomb coefficient against everything."""

    def __post_init__(self) -> None:
        check_vectors(self, position=3, half_sides=3, quat_wxyz=4)
        check_at_least_zero(self, "friction")
        if not min(self.half_sides) > 0:
            raise BadInput(f"half_sides must be positive, got {list(self.half_sides)}")
        check_unit_quaternion(self)


@renamed_fields(push="impulse_fraction", again="refracture_by")
@dataclass(frozen=True)
class Scene:
    """Everything that a simulation needs besides shapes, materials and a breaker."""

    shapes: tuple[Placed, ...]
    balls: tuple[Ball, ...] = ()
    floor: Floor | None = None
    gravity: float = GRAVITY
    """Along -z [m/s^2]."""
    duration: float = 5.0
    """Longest time simulated [s]; the simulation ends sooner once everything is at rest."""
    frame_rate: int = 60
    """Frames a second in the recording."""
    steps_per_second: int = 240
    """Of the engine; a multiple of the frame rate."""
    friction: float = 0.5
    """Coulomb coefficient between bodies."""
    restitution: float = 0.2
    """Of every contact."""
    impulse_fraction: float = field(default=0.3, metadata={"key": "push"})
    """Share of a breaking collision's impulse that the shape takes as a whole before fragments replace it: with 1
    they start from the velocity after the collision, with 0 from the velocity before it, and the striker keeps
    going and pushes the fragments that it meets. Momentum is conserved for every fraction. `push` in a scene file."""
    engine: str = "rapier"
    seed: int = 0
    breaker: str = ""
    """Which breaker to use; empty: whatever the caller has."""
    blocks: tuple[Block, ...] = ()
    refracture: int = 0
    """Generations of fragments that may break again (see `world.refracture`) ..."""
    refracture_by: str = field(default="anything", metadata={"key": "again"})
    """... and what breaks them: "anything" that they meet, or only "balls" that entered after them (see
    `physics_world.MIN_BALL_SPEED`), which is much less work. `again` in a scene file."""

    def __post_init__(self) -> None:
        if not self.shapes:
            raise BadInput("shapes must name at least one shape")
        check_positive(self, "duration", "friction")
        check_at_least_zero(self, "gravity", "restitution", "impulse_fraction")
        check_whole(self, "frame_rate", "steps_per_second", "seed", "refracture")
        for name in ("restitution", "impulse_fraction"):
            if getattr(self, name) > 1:
                raise BadInput(f"{name} must be at most 1, got {getattr(self, name)}")
        if self.frame_rate < 1 or self.steps_per_second < 1 or self.steps_per_second % self.frame_rate:
            raise BadInput(
                f"steps_per_second must be a multiple of frame_rate, got {self.steps_per_second} and {self.frame_rate}"
            )
        if self.frame_rate > MAX_FRAMES / self.duration or self.steps_per_second > MAX_STEPS / self.duration:
            raise BadInput(
                f"duration must be shorter: {self.duration:g} s have more than {MAX_FRAMES} frames or {MAX_STEPS} steps"
            )
        if not isinstance(self.engine, str) or self.engine not in ENGINES:
            near = did_you_mean(str(self.engine), ENGINES)
            raise BadInput(f"engine must be one of {', '.join(ENGINES)}, got {shortened(self.engine)}{near}")
        if self.refracture_by not in ("anything", "balls"):
            raise BadInput(f"refracture_by must be anything or balls, got {shortened(self.refracture_by)}")
        if not isinstance(self.breaker, str):
            raise BadInput(f"breaker must be text, got {shortened(self.breaker)}")

    @property
    def contact_material(self) -> ContactMaterial:
        """Friction and restitution of its contacts."""
        fixed = {f"block{i}": block.friction for i, block in enumerate(self.blocks)}
        if self.floor is not None:
            fixed["floor"] = self.floor.friction
        return ContactMaterial(self.friction, self.restitution, fixed)
