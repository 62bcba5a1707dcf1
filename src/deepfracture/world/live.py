"""A scene that runs frame by frame and takes balls while it runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepfracture.runtime.progress import stage as timed
from deepfracture.types import Breaker, Fragments, Impact, Material, Mesh, Recording, Shape
from deepfracture.world.collisions import CollisionEvent
from deepfracture.world.engine import BodyState
from deepfracture.world.physics_world import PhysicsWorld
from deepfracture.world.recorder import Pose, Recorder
from deepfracture.world.refracture import fragments_to_whole, impact_to_fragment
from deepfracture.world.scene import Ball, Scene


@dataclass(frozen=True, eq=False)
class Collision:
    """A collision for which a breaker was called."""

    body: str
    """Name of the track."""
    shape: Shape
    """The whole, also if a fragment of it was struck: impact and fragments are in its frame."""
    time: float
    """[s]"""
    frame: int
    """Last frame of the recording before it."""
    impact: Impact
    before: BodyState
    after: BodyState
    fragments: Fragments | None
    """None: it did not break."""
    generation: int = 0
    """Of what was struck: 0 for a whole shape, 1 for a fragment of it, and so on."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A simulated scene."""

    recording: Recording
    collisions: tuple[Collision, ...]

    @property
    def breaks(self) -> tuple[Collision, ...]:
        """The collisions that broke something."""
        return tuple(c for c in self.collisions if c.fragments is not None)


class Live:
    """An interactive simulation: `advance` it, `throw` balls into it, take its `outcome` at any time.

    The breaker is called for every collision of a whole shape that is faster than a settling contact, and for those of
    fragments as `Scene.refracture` says (see `world.refracture`). Everything is recorded from the start, so that
    `scene()`, run with the same breaker and generator, gives the same poses again. Use it as a context manager, or
    `close` it: the engine holds memory of its own."""

    def __init__(
        self,
        scene: Scene,
        shapes: Sequence[Shape],
        breaker: Breaker,
        rng: np.random.Generator,
        *,
        materials: Mapping[str, Material],
    ) -> None:
        self._world = PhysicsWorld(scene, shapes, materials)
        self._recorder = Recorder(scene, shapes[0])
        self._breaker, self._rng = breaker, rng
        self.collisions: list[Collision] = []
        """All so far."""
        self.at_rest = False
        """Whether everything is at rest and no ball is to come; only a `throw` changes that."""
        self._recorder.record(self._world.moving())

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the engine."""
        self._world.close()

    @property
    def frames(self) -> int:
        """Frames recorded so far."""
        return self._recorder.frames

    def at(self, frame: float) -> list[Pose]:
        """Poses of all moving bodies at a frame recorded so far, or between two."""
        return self._recorder.poses(frame)

    def throw(self, ball: Ball) -> Ball:
        """Let a ball enter with the next step, whatever its delay; returns it with its actual delay."""
        scene = self._world.scene
        # Half a step ahead: between two steps, so that rounding cannot shift it to another one in a replay.
        ball = replace(ball, delay=self._world.time + 0.5 / scene.steps_per_second)
        self._world.queue_ball(ball)
        self.at_rest = False
        return ball

    def advance(self) -> bool:
        """Simulate one frame. Returns False, and does nothing, while everything is at rest."""
        if self.at_rest:
            return False
        scene = self._world.scene
        for _ in range(scene.steps_per_second // scene.frame_rate):
            for event in self._world.step():
                self.collisions.append(self._break(event))
        moving = self._world.depenetrate(self._world.moving())
        self._recorder.record(moving)
        self.at_rest = self._world.settle(moving, self._recorder.frame_time)
        return True

    def mesh(self, name: str) -> Mesh:
        """The mesh of a body that is or was there."""
        return self._recorder.mesh(name)

    def scene(self) -> Scene:
        """The scene with all balls thrown and the time passed so far: `simulate` reproduces it exactly."""
        scene = self._world.scene
        # Half a frame more, so that rounding cannot drop the last one.
        return replace(scene, duration=(self.frames - 0.5) / scene.frame_rate)

    def outcome(self) -> Outcome:
        """The recording and collisions so far."""
        return Outcome(self._recorder.recording(), tuple(self.collisions))

    def _break(self, event: CollisionEvent) -> Collision:
        """Call the breaker, and put fragments in the place of the body if it breaks."""
        body = event.body
        assert body.shape is not None and body.whole is not None
        if body.source is None:
            fragments = self._breaker(body.shape, event.impact, self._rng)
        else:
            own = self._breaker(body.shape, impact_to_fragment(event.impact, body.shape), self._rng)
            fragments = own and fragments_to_whole(own, body.shape, body.source)
        if fragments is not None:
            with timed("put in"):
                self._world.replace(event, fragments)
        time, frame = self._world.time, self.frames - 1
        return Collision(
            body.name, body.whole, time, frame, event.impact, event.before, event.after, fragments, body.generation
        )
