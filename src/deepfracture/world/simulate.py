"""Scenes in motion: `simulate` to the end, `first_impact` to the first collision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepfracture.types import Breaker, Fragments, Impact, Material, Recording, Shape
from deepfracture.world.engine import Motion
from deepfracture.world.recorder import Recorder
from deepfracture.world.scene import Scene
from deepfracture.world.stage import Hit, Stage


@dataclass(frozen=True, eq=False)
class Collision:
    """One collision that a breaker was asked about."""

    body: str
    """Name of the track."""
    shape: Shape
    time: float
    """[s]"""
    frame: int
    """Last frame of the recording before it."""
    impact: Impact
    before: Motion
    after: Motion
    fragments: Fragments | None
    """None: it did not break."""


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
    the breaker; fragments do not break again (as in the paper).
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
    assert hit.body.shape is not None
    fragments = breaker(hit.body.shape, hit.impact, rng)
    if fragments is not None:
        recorder.knows(stage.shatter(hit, fragments), fragments)
    frame = recorder.frames - 1
    return Collision(hit.body.name, hit.body.shape, stage.time, frame, hit.impact, hit.before, hit.after, fragments)
