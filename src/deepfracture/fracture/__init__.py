"""Brittle fracture: Hertz contact, elastostatics by boundary elements, crack growth, fragments."""

from deepfracture.fracture.body import FractureBody, prepare_body
from deepfracture.fracture.contact import breaks, critical_stress
from deepfracture.fracture.materials import MATERIALS, material
from deepfracture.fracture.mechanisms import Mechanisms
from deepfracture.fracture.similarity import FragmentSimulator, prepare_fragment, rescale_material
from deepfracture.fracture.simulate import FractureResult, simulate

__all__ = [
    "MATERIALS",
    "FractureBody",
    "FractureResult",
    "FragmentSimulator",
    "Mechanisms",
    "breaks",
    "critical_stress",
    "material",
    "prepare_body",
    "prepare_fragment",
    "rescale_material",
    "simulate",
]
