"""Runs a scene: `simulate` to the end, `first_impact` and `joint_impact` to the first collision of one or all balls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from deepfracture.types import Breaker, Impact, Material, Shape
from deepfracture.world.impact import merge_impacts
from deepfracture.world.live import Live, Outcome
from deepfracture.world.physics_world import PhysicsWorld
from deepfracture.world.scene import Scene


def simulate(
    scene: Scene,
    shapes: Sequence[Shape],
    breaker: Breaker,
    rng: np.random.Generator,
    *,
    materials: Mapping[str, Material],
    engine: str | None = None,
) -> Outcome:
    """Run a scene until everything is at rest or its duration is over.

    `shapes` are the meshes of `scene.shapes`, in order; `materials` are looked up by the scene's names;
    `engine` overrides the scene's. Which collisions the breaker is called for, see `Live`.
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
    world = PhysicsWorld(replace(scene, engine=engine or scene.engine), [shape], materials)
    try:
        for _ in range(int(scene.duration * scene.steps_per_second)):
            for event in world.step():
                return event.impact
        return None
    finally:
        world.close()


def joint_impact(
    scene: Scene, shape: Shape, *, materials: Mapping[str, Material], engine: str | None = None
) -> Impact | None:
    """The first hits of all balls of a scene on its one shape as one `Impact`; None if all miss.

    The world runs with the shape unbroken until every ball has hit or the time is over. Each hit keeps its position in
    the body frame, wherever the body was by then, and all are taken to act at once: an approximation, good where the
    balls arrive before the body has turned away. Balls that miss are left out."""
    world = PhysicsWorld(replace(scene, engine=engine or scene.engine), [shape], materials)
    waiting = {f"ball{i}" for i in range(len(scene.balls))}
    impacts: list[Impact] = []
    try:
        for _ in range(int(scene.duration * scene.steps_per_second)):
            for event in world.step():
                struck = waiting & {striker.body.name for striker in event.strikers}
                if struck:
                    impacts.append(event.impact)
                    waiting -= struck
                if not waiting:
                    return merge_impacts(impacts)
        return merge_impacts(impacts) if impacts else None
    finally:
        world.close()
