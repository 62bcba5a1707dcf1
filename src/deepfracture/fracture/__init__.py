"""Brittle fracture: elastostatics by boundary elements, contact, and cracks that grow."""

from .body import FractureBody, prepare_body
from .contact import breaks, critical_stress
from .materials import MATERIALS, material
from .mechanisms import Mechanisms
from .similar import Pieces, prepare_piece, similar
from .simulate import Cracking, simulate

__all__ = [
    "MATERIALS",
    "Cracking",
    "FractureBody",
    "Mechanisms",
    "Pieces",
    "breaks",
    "critical_stress",
    "material",
    "prepare_body",
    "prepare_piece",
    "similar",
    "simulate",
]
