"""The world of one player: its shape, the balls thrown at it, the results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from deepfracture.breakers import REFRACTURING
from deepfracture.fracture import critical_stress
from deepfracture.fracture import material as preset
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.play.breaker_cache import BreakerCache
from deepfracture.play.launch import Obstacle, launch
from deepfracture.play.library import Entry
from deepfracture.runtime.progress import collect_stages
from deepfracture.types import BadInput, Floats, Recording
from deepfracture.world import GRAVITY, UPRIGHT, Ball, Collision, Floor, Live, Pose, Scene, place_on_floor, throw_scene

GENERATIONS = 3
"""Of fragments that may break again, when a ball hits them: testing all that fall would take too long."""
MAX_BALLS = 60
"""Balls in one world ..."""
MAX_SECONDS = 120.0
"""... and its duration [s]: the recording is kept in memory."""
WARM_UP_SPEED = 12.0
"""Of the ball that breaks a shape once in advance [m/s]."""


@dataclass(frozen=True)
class Setup:
    """Settings of a world; a change resets it."""

    breaker: str
    material: str = "plaster"
    up: str = "z"
    """Axis of the file that points up."""
    gravity: float = GRAVITY
    """[m/s^2]"""
    seed: int = 0

    def __post_init__(self) -> None:
        preset(self.material)
        if self.up not in UPRIGHT:
            raise BadInput(f"up must be x, y or z, got {self.up!r}")


@dataclass(frozen=True)
class Shot:
    """How a ball is thrown."""

    radius: float = 0.2
    """[m]"""
    speed: float = 14.0
    """[m/s]"""


@dataclass(frozen=True)
class Readout:
    """Result of a shot: the strongest of its collisions that broke something, or of all."""

    body: str
    """Name of the body that was struck."""
    impulse: float
    """Of the strongest contact [N s]."""
    stress: float
    """sigma_1 [Pa]."""
    strength: float
    """sigma_0 of the material [Pa]."""
    fragments: int
    """Number of fragments; 0: it did not break."""
    pieces: int
    """Fragments in the world now."""
    milliseconds: Mapping[str, float] = field(default_factory=dict)
    """Duration of each stage of the break."""


class Session:
    """The world of one player. Not thread-safe."""

    def __init__(self, breakers: BreakerCache, entry: Entry, setup: Setup) -> None:
        """BadInput if the setup does not fit the shape."""
        self.breakers, self.entry, self.setup = breakers, entry, setup
        self._live = self._start()
        self._collisions: list[tuple[Collision, dict[str, float]]] = []
        """The collisions since the last shot, each with the milliseconds of its stages."""

    @property
    def frames(self) -> int:
        """Frames recorded so far; the last one is the present."""
        return self._live.frames

    @property
    def frame_rate(self) -> int:
        """Frames a second of the world's time."""
        return self._live.scene().frame_rate

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves until the next shot."""
        return self._live.at_rest

    def at(self, frame: float) -> list[Pose]:
        """Poses of all moving bodies at a frame, or between two."""
        return self._live.at(frame)

    def recording(self) -> Recording:
        """The recording so far."""
        return self._live.outcome().recording

    def scene(self) -> Scene:
        """The scene with which `simulate` reproduces it."""
        return self._live.scene()

    @property
    def full(self) -> str:
        """Why no more balls can be thrown; "" if they can."""
        if len(self._live.scene().balls) >= MAX_BALLS:
            return f"{MAX_BALLS} balls are the maximum in one world: reset it"
        if self.frames > MAX_SECONDS * self.frame_rate:
            return f"{MAX_SECONDS:.0f} s are the maximum for one world: reset it"
        return ""

    def shoot(self, origin: Floats, direction: Floats, shot: Shot) -> Ball | None:
        """Throw a ball along a ray, from just before what it will hit.

        None if there is no room for it, or no more balls can be thrown."""
        if self.full:
            return None
        ball = launch(
            np.asarray(origin, float), np.asarray(direction, float) / np.linalg.norm(direction), radius=shot.radius,
            speed=shot.speed, obstacles=self._obstacles(), floor=0.0, gravity=self.setup.gravity,
        )  # fmt: skip
        if ball is None:
            return None
        self._collisions = []
        return self._live.throw(ball)

    def step(self) -> bool:
        """Simulate one frame, including any break; False if nothing moves."""
        known = len(self._live.collisions)
        with collect_stages() as stages:
            moved = self._live.advance()
        milliseconds: dict[str, float] = {}
        for done in stages:
            milliseconds[done.stage] = milliseconds.get(done.stage, 0.0) + 1e3 * done.seconds
        self._collisions += [(collision, milliseconds) for collision in self._live.collisions[known:]]
        return moved

    def reset(self, entry: Entry | None = None, setup: Setup | None = None) -> None:
        """Start again, with another shape or setup if given. BadInput if they do not fit; the world then stays."""
        former = self._live, self.entry, self.setup
        self.entry, self.setup = entry or self.entry, setup or self.setup
        try:
            self._live = self._start()
        except BadInput:
            _, self.entry, self.setup = former
            raise
        former[0].close()
        self._collisions = []

    def close(self) -> None:
        """Release the engine."""
        self._live.close()

    def readout(self) -> Readout | None:
        """Result of the last shot; None while it has hit nothing."""
        if not self._collisions:
            return None
        broke = [known for known in self._collisions if known[0].fragments is not None]
        main, milliseconds = max(broke or self._collisions, key=lambda known: float(known[0].impact.magnitude[0]))
        material = preset(self.setup.material)
        area = float(np.linalg.norm(self._live.mesh(main.body).area_vectors, axis=1).sum())
        return Readout(
            body=main.body,
            impulse=float(main.impact.magnitude[0]),
            stress=critical_stress(main.impact, material, area),
            strength=material.strength,
            fragments=0 if main.fragments is None else len(main.fragments),
            pieces=sum(pose.kind == "fragment" for pose in self.at(self.frames - 1)),
            milliseconds=milliseconds if main.fragments is not None else {},
        )

    def _start(self) -> Live:
        setup, shape = self.setup, self.entry.shape
        breaker = self.breakers.breaker(self.entry, setup.breaker, setup.material)
        placed = place_on_floor(
            self.entry.source, shape, material=setup.material, quat_wxyz=UPRIGHT[setup.up], repair=self.entry.repair
        )
        scene = Scene(
            (placed,), floor=Floor(), gravity=setup.gravity, seed=setup.seed, breaker=setup.breaker,
            refracture=GENERATIONS if setup.breaker in REFRACTURING else 0, refracture_by="balls",
        )  # fmt: skip
        materials = {setup.material: preset(setup.material)}
        return Live(scene, [shape], breaker, np.random.default_rng(setup.seed), materials=materials)

    def _obstacles(self) -> list[Obstacle]:
        poses = self.at(self.frames - 1)
        return [Obstacle(pose.mesh, pose.position, rotation_matrix(pose.quat_wxyz)) for pose in poses]


def warm_up(breakers: BreakerCache, entry: Entry, setup: Setup) -> int:
    """Break a shape once in a world of its own, so that everything is compiled, loaded and cached.

    Returns the number of fragments, 0 if it did not break."""
    shape = entry.shape
    breaker = breakers.breaker(entry, setup.breaker, setup.material)
    scene = throw_scene(
        entry.source, shape, np.random.default_rng(0), material=setup.material, speed=WARM_UP_SPEED,
        quat_wxyz=UPRIGHT[setup.up],
    )  # fmt: skip
    scene = replace(scene, gravity=setup.gravity)
    with Live(
        scene, [shape], breaker, np.random.default_rng(0), materials={setup.material: preset(setup.material)}
    ) as live:
        while not live.at_rest and not live.collisions:
            live.advance()
        return sum(len(collision.fragments or ()) for collision in live.collisions)
