"""Fragments as bodies of their own, by dynamic similarity with a body two metres long.

A fragment whose box is 2 s metres long is broken in its own frame, where that side is 2: lengths are
divided by s. With the same stiffness, density and speed, stresses, strains and wave speeds are those of the
fragment, and so is its strength; then

    times, radii        t / s, R / s        (waves cross it that much sooner)
    masses, impulses    m / s^3, I / s^3
    toughness           K / sqrt(s)         (K ~ stress * sqrt(length): a small body is relatively tougher)
    lengths             variation / s, roughness / s

which preserves every ratio of the mechanics (Hertz, Griffith, Mott). `world.refracture` scales the impact,
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

FRAGMENT_ELEMENTS = 500
"""Boundary elements of a fragment: a third of a whole shape's, so an eighth of the factorisation."""

MAX_PREPARED = 8
"""Fragments that stay prepared: one that withstands a hit is often hit again. About 20 MB each."""


def rescale_material(material: Material, size: float) -> Material:
    """The material with which a body of one metre per unit behaves like one of `size` metres per unit."""
    return replace(
        material,
        toughness=material.toughness / size**0.5,
        variation_length=material.variation_length / size,
        roughness=material.roughness / size,
    )


def prepare_fragment(shape: Shape, material: Material, grid: Grid) -> FractureBody:
    """Prepare a fragment of a shape, as `prepare_body` does a whole one; `grid` is that of the whole.

    Voxels are about as large as those of the whole. Nothing is cached on disk: no fragment occurs twice.
    Raises BadInput if the fragment is too thin for so few elements."""
    resolution = next(r for r in RESOLUTIONS if r >= min(grid.resolution * shape.size, RESOLUTIONS[-1]))
    return prepare_body(
        shape, rescale_material(material, shape.size), Grid(resolution), elements=FRAGMENT_ELEMENTS, cache=False
    )


@dataclass(frozen=True)
class FragmentSimulator:
    """Simulates the fracture of fragments; the last MAX_PREPARED stay prepared."""

    material: Material
    grid: Grid
    """Grid of the whole shape."""
    _bodies: LRU[Shape, FractureBody | None] = field(default_factory=lambda: LRU(MAX_PREPARED))

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> FracturePattern | None:
        """The pattern of a fragment under an impact scaled to it; None without fracture."""
        area = float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
        if not breaks(impact, self.material, area):
            return None
        body = self._bodies.get(shape, lambda: self._prepared(shape))
        result = None if body is None else simulate(body, impact, rng)
        return result.pattern if result else None

    def _prepared(self, shape: Shape) -> FractureBody | None:
        """None for a sliver that boundary elements cannot resolve: it does not break again."""
        try:
            with stage("prepare fragment"):
                return prepare_fragment(shape, self.material, self.grid)
        except BadInput as problem:
            log.info(
                "%s does not break again: %s", shape.name, str(problem)
            )  # a string, as the error would keep the shape alive
            return None
