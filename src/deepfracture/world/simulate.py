"""Scenes in motion: `simulate` to the end, `first_impact` to the first collision, `joint_impact` to that of
the last ball."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from deepfracture.types import Breaker, Impact, Material, Shape
from deepfracture.world.impulse import merged
from deepfracture.world.live import Live, Outcome
from deepfracture.world.scene import Scene
from deepfracture.world.stage import Stage


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
    `engine` overrides the scene's. What goes to the breaker, see `Live`.
    """
    scene = replace(scene, engine=engine or scene.engine)
    with Live(scene, shapes, breaker, rng, materials=materials) as live:
        for _ in range(int(np.floor(scene.duration * scene.frame_rate))):
            live.advance()
            if live.at_rest:
                break
        return live.outcome()


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
