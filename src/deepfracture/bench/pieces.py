"""Something broken to measure on: cells of random sites, the same whatever the simulator does."""

from __future__ import annotations

import numpy as np

from deepfracture.carve import voronoi_pattern
from deepfracture.types import Floats32, FracturePattern, Grid

CELLS = 24
"""Sites of the pattern: about as many fragments as a medium hit leaves."""
DENSITY = 1000.0
"""[kg/m^3]"""


def cells(surface: Floats32, grid: Grid, rng: np.random.Generator) -> FracturePattern:
    """Voronoi cells of random sites inside a body with the distance `surface` to its surface, shape (r, r, r)."""
    inside = grid.centres()[surface > 0]
    return voronoi_pattern(inside[rng.choice(len(inside), CELLS, replace=False)], surface, grid)
