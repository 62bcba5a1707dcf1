"""What takes part in a fracture, for those who want to see what one mechanism does."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mechanisms:
    """All mechanics; the models for looks belong to the material (roughness, spread and length of its variation)."""

    release: bool = True
    """Cracks let go of the stress across them, release waves run, and what still holds takes the load over
    (Bueckner 1958; Mott 1947)."""
    contact: bool = True
    """Faces of a crack that are pressed together carry the pressure; without friction. Needs `release`."""
    mouth: bool = True
    """The tension at a crack's mouth drives it through the wall although the far side is pressed (Tada 2.13)."""
