"""Random collisions of a shape, as the learning data have them."""

from __future__ import annotations

import numpy as np

from deepfracture.fracture import breaks
from deepfracture.types import BadInput, Impact, Material, Shape
from deepfracture.world import first_impact, single_ball_scene

SPEEDS = (5.0, 30.0)
"""Slowest and fastest ball [m/s]: from hits that just break a heavy body to those that shatter it."""
TRIES = 20
"""Balls thrown for each hit that is wanted, before giving up."""


def random_hits(
    shape: Shape, material: Material, count: int, *, speeds: tuple[float, float] = SPEEDS, seed: int = 0
) -> list[Impact]:
    """The first `count` random collisions with balls of `speeds` [m/s] that meet the criterion of breaking.

    Raises BadInput when next to none of them does."""
    area = float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
    hits: list[Impact] = []
    for k in range(TRIES * count):
        rng = np.random.default_rng([seed, k])
        scene = single_ball_scene(shape.name, shape, rng, material=material.name, speed=speeds)
        impact = first_impact(scene, shape, materials={material.name: material})
        if impact is not None and breaks(impact, material, area):
            hits.append(impact)
        if len(hits) == count:
            return hits
    raise BadInput(f"{shape.name}: only {len(hits)} of {TRIES * count} random collisions can break it; need {count}")
