"""Options of a breaker, for the command line and for Python."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

BREAKERS = ("learned", "physical", "voronoi", "nearest", "cvd", "random")
REFRACTURING = ("learned", "physical", "voronoi")
"""Breakers that can break a fragment that is hit again."""
RENAMED = {"budget": "max_faces"}
"""Deprecated names of options."""


@dataclass(frozen=True)
class BreakerOptions:
    """What a breaker is made from, and how finely it breaks."""

    model: Path | None = None
    """Trained weights for learned, instead of the shipped ones."""
    dataset: Path | None = None
    """Simulated patterns, which nearest and random reuse and cvd takes the number of fragments from."""
    resolution: int = 64
    """Voxels along each axis for physical, voronoi and cvd: 32, 64, 128 or 256."""
    roughness: float = 0.0
    """Grain of the crack faces [m], of a body two metres long."""
    max_faces: int | None = None
    """Most triangles of a fragment; crack faces are decimated as far as their boundaries allow (default: no limit)."""
