"""A scene in motion, frame by frame, into which balls can be thrown while it runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepfracture.runtime.progress import stage as timed
from deepfracture.types import Breaker, Fragments, Impact, Material, Mesh, Recording, Shape
from deepfracture.world.engine import Motion
from deepfracture.world.pieces import real, scaled
from deepfracture.world.recorder import Pose, Recorder
from deepfracture.world.scene import Ball, Scene
from deepfracture.world.stage import Hit, Stage


@dataclass(frozen=True, eq=False)
class Collision:
    """One collision that a breaker was asked about."""

    body: str
    """Name of the track."""
    shape: Shape
    """The whole, also where a fragment of it was struck: impact and fragments are in its frame."""
    time: float
    """[s]"""
    frame: int
    """Last frame of the recording before it."""
    impact: Impact
    before: Motion
    after: Motion
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
    """A scene that somebody watches: `advance` it, `throw` balls into it, ask for its `outcome` at any time.

    Every collision of a whole shape faster than a settling contact goes to the breaker, and of fragments as far
    as `Scene.refracture` says (see `world.pieces`). What has happened is written down from the start on, so that
    `scene()`, run from the start with the same breaker and generator, gives the same poses again. Use it as a
    context, or `close` it: the engine holds memory of its own."""

    def __init__(
        self,
        scene: Scene,
        shapes: Sequence[Shape],
        breaker: Breaker,
        rng: np.random.Generator,
        *,
        materials: Mapping[str, Material],
    ) -> None:
        self._stage = Stage(scene, shapes, materials)
        self._recorder = Recorder(scene, shapes[0])
        self._breaker, self._rng = breaker, rng
        self.collisions: list[Collision] = []
        """All so far."""
        self.at_rest = False
        """Whether everything lies still and no ball is awaited; then nothing but a `throw` changes that."""
        self._recorder.frame(self._stage.moving())

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the engine."""
        self._stage.close()

    @property
    def frames(self) -> int:
        """Frames written down so far."""
        return self._recorder.frames

    def at(self, frame: float) -> list[Pose]:
        """Where everything that can move was at a frame so far, or between two."""
        return self._recorder.at(frame)

    def throw(self, ball: Ball) -> Ball:
        """Let a ball enter with the next step, whatever its delay says; returns it with the delay that it has."""
        scene = self._stage.scene
        # Half a step from now: between two steps, so that rounding cannot make it another one in a replay.
        ball = replace(ball, delay=self._stage.time + 0.5 / scene.steps_per_second)
        self._stage.expect(ball)
        self.at_rest = False
        return ball

    def advance(self) -> bool:
        """One frame. Returns whether time went on: while everything rests it does not."""
        if self.at_rest:
            return False
        scene = self._stage.scene
        for _ in range(scene.steps_per_second // scene.frame_rate):
            for hit in self._stage.step():
                self.collisions.append(self._ask(hit))
        moving = self._stage.lift(self._stage.moving())
        self._recorder.frame(moving)
        self.at_rest = self._stage.settle(moving, self._recorder.frame_time)
        return True

    def mesh(self, name: str) -> Mesh:
        """The mesh of the body with that name, which may have broken since."""
        return self._recorder.mesh(name)

    def scene(self) -> Scene:
        """The scene with all balls thrown so far, as long as it has lasted: `simulate` repeats it exactly."""
        scene = self._stage.scene
        # Half a frame more, so that rounding cannot drop the last one.
        return replace(scene, duration=(self.frames - 0.5) / scene.frame_rate)

    def outcome(self) -> Outcome:
        """What has happened so far."""
        return Outcome(self._recorder.recording(), tuple(self.collisions))

    def _ask(self, hit: Hit) -> Collision:
        body = hit.body
        assert body.shape is not None
        if body.source is None:
            whole, fragments = body.shape, self._breaker(body.shape, hit.impact, self._rng)
        else:
            assert body.shape.whole is not None
            whole, fragments = body.shape.whole, self._breaker(body.shape, scaled(hit.impact, body.shape), self._rng)
            fragments = fragments and real(fragments, body.shape, body.source)
        if fragments is not None:
            with timed("put in"):
                self._recorder.knows(self._stage.shatter(hit, fragments), fragments, whole)
        return Collision(
            body.name, whole, self._stage.time, self.frames - 1, hit.impact, hit.before, hit.after, fragments,
            body.generation,
        )  # fmt: skip
