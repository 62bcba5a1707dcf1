"""Switches of the fracture mechanisms, for ablation studies."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mechanisms:
    """Mechanisms of the simulation; the models of appearance (roughness, variation) belong to the material."""

    release: bool = True
    """Cracks relieve the stress across them, release waves propagate, and the load shifts to the intact material
    (Bueckner 1958; Mott 1947)."""
    contact: bool = True
    """Crack faces pressed together carry pressure, without friction. Needs `release`."""
    mouth: bool = True
    """The tension at a crack's mouth drives it through the wall although the far side is compressed (Tada 2.13)."""
