"""Options of a simulated data set, for the command line and for Python."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SimulateOptions:
    """Which collisions to simulate, and on what."""

    collisions: int = 60
    """Balls to throw; collisions without fracture are counted and left out."""
    resolution: int = 64
    """Voxels along each axis."""
    speed: tuple[float, float] = (4.0, 15.0)
    """Slowest and fastest ball [m/s]."""
    scene: str = "single"
    """single, dual (two balls), strength (one line, many speeds), points (one direction, many points) or shear (beside
    the edge of a block)."""
    refracture: int = 0
    """Generations of fragments that may break again when they meet each other or the ball ..."""
    frames: int = 60
    """... within this many frames after the hit, at 60 a second."""
    repeats: int = 1
    """Times that each collision is simulated, with other weak places in the material (for evaluate)."""
    workers: int | None = None
    """Collisions at once (default: two, or all processors of a cluster)."""
    executor: str = "local"
    """local, or ray: the machines of a cluster."""
    address: str | None = None
    """Of the Ray cluster (default: the one that this machine belongs to)."""
    limit: float = 600.0
    """Seconds after which a collision is given up and counts as failed."""
    memory: float | None = None
    """Gigabytes beyond which a worker is ended and its collision counts as failed (default: no limit)."""
    retry: bool = False
    """First drop what failed or is damaged, and simulate it again."""
    seed: int = 0
    """The same seed gives the same bytes, however many workers."""
