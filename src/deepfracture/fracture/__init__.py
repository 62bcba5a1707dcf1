"""Brittle fracture: elastostatics by boundary elements, contact, and cracks that grow."""

from deepfracture.fracture.body import FractureBody, prepare_body
from deepfracture.fracture.contact import breaks, critical_stress
from deepfracture.fracture.materials import MATERIALS, material
from deepfracture.fracture.mechanisms import Mechanisms
from deepfracture.fracture.similar import Pieces, prepare_piece, similar
from deepfracture.fracture.simulate import Cracking, simulate

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
