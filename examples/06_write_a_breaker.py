"""A way to break of your own: the spider's web of a struck pane, in thirty lines.

    python examples/06_write_a_breaker.py

A breaker is any function (Shape, Impact, Generator) -> Fragments or None. Usually one only says which fragment each
voxel belongs to and how far the next crack is, a `FracturePattern`; `PatternBreaker` adds the criterion before and the
cut of the original mesh after it. The world does not know the difference: the plate falls apart like any other.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from starting import start

import deepfracture as df
from deepfracture.breakers import PatternBreaker
from deepfracture.geometry import voxels_inside
from deepfracture.render import exploded


@dataclass(frozen=True)
class SpiderWeb:
    """Straight cracks that radiate from the hit, and rings around it."""

    grid: df.Grid
    rays: int = 13
    rings: tuple[float, ...] = (0.18, 0.4, 0.75)
    """Radii [m]."""

    def __call__(self, shape: df.Shape, impact: df.Impact, rng: np.random.Generator) -> df.FracturePattern:
        inside = voxels_inside(shape.mesh, self.grid)
        along = impact.direction[0]
        across = np.cross(along, np.eye(3)[np.abs(along).argmin()])
        across /= np.linalg.norm(across)
        away = self.grid.centres() - impact.position[0]  # (r, r, r, 3)
        x, y = away @ across, away @ np.cross(along, across)
        radius, angle = np.hypot(x, y), np.arctan2(y, x)
        rays = np.sort(rng.uniform(-np.pi, np.pi, self.rays))
        rings = np.array(self.rings) * rng.uniform(0.85, 1.15, len(self.rings))
        sector = np.searchsorted(rays, angle) % self.rays
        labels = np.where(inside, 1 + sector + self.rays * np.searchsorted(rings, radius), 0)
        # Only half of each line is a crack: beyond the hit the ray does not go on.
        turn = np.abs((angle[..., None] - rays + np.pi) % (2 * np.pi) - np.pi)
        to_ray = (radius[..., None] * np.where(turn < np.pi / 2, np.sin(turn), 1)).min(axis=-1)
        to_ring = np.abs(radius[..., None] - rings).min(axis=-1)
        return df.FracturePattern(self.grid, labels.astype(np.int32), np.minimum(to_ray, to_ring).astype(np.float32))


def write_a_breaker(
    out: Path = Path("runs/06_write_a_breaker"),
    *,
    speed: float = 60,
    resolution: int = 64,
    size: tuple[int, int] = (560, 440),
    seed: int = 1,
) -> None:
    """Break a plate that stands on its rim like a pane, and let it fall.

    Args:
        out: folder.
        speed: of the ball [m/s].
        resolution: voxels along each axis.
        size: width and height of each picture [pixel].
        seed: the same seed breaks the same way.
    """
    plate = df.load("plate")
    breaker = PatternBreaker(SpiderWeb(df.Grid(resolution)), df.material("glass"))
    outcome = df.throw(plate, breaker, speed=speed, up="y", heading=270, seed=seed)
    if not outcome.breaks:
        raise df.BadInput(f"speed {speed:g} does not break a plate of glass; throw faster")
    df.save(outcome, out / "plate.glb")
    df.save(outcome, out / "plate.png")
    df.save(outcome.breaks[0], out / "pieces")
    fragments = outcome.breaks[0].fragments
    assert fragments is not None
    exploded(fragments, out / "pieces.png", shape=plate, factor=0.25, size=size, elevation=50)


if __name__ == "__main__":
    start(write_a_breaker)
