"""A fragment as a body of its own: dynamic similarity between it and a body two metres long.

A fragment whose box is 2 s metres long is broken in its own frame, where that side is 2: lengths are
divided by s. With the same stiffness, density and speed, stresses, strains and wave speeds are those of the
fragment, and so is its strength; then

    times, radii        t / s, R / s        (waves cross it so much sooner)
    masses, impulses    m / s^3, I / s^3
    toughness           K / sqrt(s)         (K ~ stress * sqrt(length): a small body is relatively tougher)
    lengths             variation / s, roughness / s

which leaves every ratio of the mechanics (Hertz, Griffith, Mott) what it was. `world.refracture` scales the impact,
this module the material.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from deepfracture.fracture.body import FractureBody, prepare_body
from deepfracture.fracture.contact import breaks
from deepfracture.fracture.simulate import simulate
from deepfracture.runtime.lru import LRU
from deepfracture.runtime.progress import log, stage
from deepfracture.types import RESOLUTIONS, BadInput, FracturePattern, Grid, Impact, Material, Shape

PIECE_ELEMENTS = 500
"""Boundary elements of a fragment: a third of a whole shape's, so an eighth of the factorisation."""

KEPT = 8
"""Fragments that stay prepared: one that withstands a hit is soon hit again. About 20 MB each."""


def similar(material: Material, size: float) -> Material:
    """The material of a body of `size` metres a unit, as a body of one metre a unit has to have it."""
    return replace(
        material,
        toughness=material.toughness / size**0.5,
        variation_length=material.variation_length / size,
        roughness=material.roughness / size,
    )


def prepare_piece(shape: Shape, material: Material, grid: Grid) -> FractureBody:
    """What `prepare_body` is to a whole shape, for a fragment of one; `grid` is that of the whole.

    Voxels are about as large as those of the whole; what is prepared is not kept on disk, for it will never
    be met again. BadInput if the fragment is too thin for so few elements."""
    enough = next(r for r in RESOLUTIONS if r >= min(grid.resolution * shape.size, RESOLUTIONS[-1]))
    return prepare_body(shape, similar(material, shape.size), Grid(enough), elements=PIECE_ELEMENTS, keep=False)


@dataclass(frozen=True)
class Pieces:
    """The simulator for fragments of whole shapes; each is prepared once, unless KEPT others came between."""

    material: Material
    grid: Grid
    """Of the whole."""
    _bodies: LRU[Shape, FractureBody | None] = field(default_factory=lambda: LRU(KEPT))

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        """How a fragment comes apart under an impact scaled to it; None if it holds."""
        area = float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
        if not breaks(impact, self.material, area):
            return None
        body = self._bodies.get(shape, lambda: self._prepared(shape))
        cracking = None if body is None else simulate(body, impact, rng)
        return cracking.pattern if cracking else None

    def _prepared(self, shape: Shape) -> FractureBody | None:
        """None for a sliver that the boundary elements cannot take: it does not break again."""
        try:
            with stage("prepare fragment"):
                return prepare_piece(shape, self.material, self.grid)
        except BadInput as problem:
            log.info("%s does not break again: %s", shape.name, str(problem))  # the error itself holds the shape
            return None
