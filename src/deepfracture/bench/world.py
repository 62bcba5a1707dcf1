"""The rigid bodies: fragments enter, and a step with all of them."""

from __future__ import annotations

import numpy as np

from deepfracture.bench.pieces import cells
from deepfracture.bench.rows import RUNS, Row, seconds
from deepfracture.carve import cut
from deepfracture.fracture import material
from deepfracture.geometry import voxels_inside
from deepfracture.runtime.memory import peak_mb
from deepfracture.types import BadInput, Fragments, Grid, Material, Shape
from deepfracture.world import Scene, throw_scene
from deepfracture.world.collisions import CollisionEvent
from deepfracture.world.physics_world import PhysicsWorld

STEPS = 60
"""Steps of the engine that follow the break, a quarter of a second: fragments still touch each other."""


def bench_world(shape: Shape, resolution: int) -> list[Row]:
    """Add the fragments of a pattern of `pieces.CELLS` cells in the place of the shape, then step."""
    grid, made_of = Grid(resolution), material("plaster")
    pattern = cells(voxels_inside(shape.mesh, grid), grid, np.random.default_rng(0))
    fragments = cut(shape, pattern, density=made_of.density)
    scene = throw_scene(shape.name, shape, np.random.default_rng(0), material=made_of.name)
    runs = [_run(scene, shape, made_of, fragments) for _ in range(RUNS + 1)][1:]
    added, stepped = np.median(np.array(runs), axis=0)
    return [
        Row(name, shape.name, resolution, float(spent), peak_mb())
        for name, spent in ((f"add {len(fragments)} fragments", added), ("step", stepped))
    ]


def _run(scene: Scene, shape: Shape, made_of: Material, fragments: Fragments) -> tuple[float, float]:
    """Seconds to add the fragments at the first event, and of a step after that, in the median."""
    world = PhysicsWorld(scene, [shape], {made_of.name: made_of})
    try:
        event = _first_hit(world)
        added = seconds(lambda: world.replace(event, fragments))
        return added, float(np.median([seconds(lambda: list(world.step())) for _ in range(STEPS)]))
    finally:
        world.close()


def _first_hit(world: PhysicsWorld) -> CollisionEvent:
    for _ in range(int(world.scene.duration * world.scene.steps_per_second)):
        for event in world.step():
            return event
    raise BadInput("the ball of the measured scene misses the shape; try another shape")
