"""Something broken to measure on: cells of random sites, the same whatever the simulator does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deepfracture.carve import voronoi_pattern
from deepfracture.types import FracturePattern, Grid

CELLS = 24
"""Sites of the pattern: about as many fragments as a medium hit leaves."""
DENSITY = 1000.0
"""[kg/m^3]"""


def cells(inside: NDArray[np.bool_], grid: Grid, rng: np.random.Generator) -> FracturePattern:
    """Voronoi cells of random sites in a body, `inside` for the voxels whose centre lies in it, shape (r, r, r)."""
    places = grid.centres()[inside]
    return voronoi_pattern(places[rng.choice(len(places), CELLS, replace=False)], inside, grid)
