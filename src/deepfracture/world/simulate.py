"""Scenes in motion: `simulate` to the end, `first_impact` to the first collision, `joint_impact` to that of
the last ball."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepfracture.types import Breaker, Fragments, Impact, Material, Recording, Shape
from deepfracture.world.engine import Motion
from deepfracture.world.impulse import merged
from deepfracture.world.pieces import real, scaled
from deepfracture.world.recorder import Recorder
from deepfracture.world.scene import Scene
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


def simulate(
    scene: Scene,
    shapes: Sequence[Shape],
    breaker: Breaker,
    rng: np.random.Generator,
    *,
    materials: Mapping[str, Material],
    engine: str | None = None,
) -> Outcome:
    """Run a scene until everything lies still or its duration is over.

    `shapes` are the meshes of `scene.shapes`, in order; `materials` are looked up by the scene's names;
    `engine` overrides the scene's. Every collision of a whole shape faster than a settling contact goes to
    the breaker, and of fragments as far as `Scene.refracture` says (see `world.pieces`).
    """
    stage = Stage(replace(scene, engine=engine or scene.engine), shapes, materials)
    try:
        return _run(stage, breaker, rng, shapes[0])
    finally:
        stage.close()


def first_impact(
    scene: Scene, shape: Shape, *, materials: Mapping[str, Material], engine: str | None = None
) -> Impact | None:
    """The first collision of a scene with one shape; None if nothing touches it in time."""
    stage = Stage(replace(scene, engine=engine or scene.engine), [shape], materials)
    try:
        for _ in range(int(scene.duration * scene.steps_per_second)):
            for hit in stage.step():
                return hit.impact
        return None
    finally:
        stage.close()


def joint_impact(
    scene: Scene, shape: Shape, *, materials: Mapping[str, Material], engine: str | None = None
) -> Impact | None:
    """What all balls of a scene with one shape do to it: their first hits as one Impact; None if all miss.

    The world runs with the shape unbroken until every ball has hit or the time is over. Each hit keeps its
    place in the body frame, wherever the body was by then, and they are taken to act at once: an
    approximation, good where the balls arrive within the time that the body needs to turn away. A ball that
    misses leaves the impact of the others."""
    stage = Stage(replace(scene, engine=engine or scene.engine), [shape], materials)
    waiting = {f"ball{i}" for i in range(len(scene.balls))}
    impacts: list[Impact] = []
    try:
        for _ in range(int(scene.duration * scene.steps_per_second)):
            for hit in stage.step():
                struck = waiting & {striker.body.name for striker in hit.strikers}
                if struck:
                    impacts.append(hit.impact)
                    waiting -= struck
                if not waiting:
                    return merged(impacts)
        return merged(impacts) if impacts else None
    finally:
        stage.close()


def _run(stage: Stage, breaker: Breaker, rng: np.random.Generator, reference: Shape) -> Outcome:
    scene = stage.scene
    recorder = Recorder(scene, reference)
    collisions: list[Collision] = []
    recorder.frame(stage.moving())
    for _ in range(int(np.floor(scene.duration * scene.frame_rate))):
        for _ in range(scene.steps_per_second // scene.frame_rate):
            for hit in stage.step():
                collisions.append(_ask(stage, recorder, hit, breaker, rng))
        moving = stage.moving()
        recorder.frame(moving)
        if stage.settle(moving, recorder.frame_time):
            break
    return Outcome(recorder.recording(), tuple(collisions))


def _ask(stage: Stage, recorder: Recorder, hit: Hit, breaker: Breaker, rng: np.random.Generator) -> Collision:
    body = hit.body
    assert body.shape is not None
    if body.source is None:
        whole, fragments = body.shape, breaker(body.shape, hit.impact, rng)
    else:
        assert body.shape.whole is not None
        whole, fragments = body.shape.whole, breaker(body.shape, scaled(hit.impact, body.shape), rng)
        fragments = fragments and real(fragments, body.shape, body.source)
    if fragments is not None:
        recorder.knows(stage.shatter(hit, fragments), fragments, whole)
    frame = recorder.frames - 1
    return Collision(body.name, whole, stage.time, frame, hit.impact, hit.before, hit.after, fragments, body.generation)
