"""Shapes: made, read, repaired, normalised, measured."""

from deepfracture.geometry.appearance import carried
from deepfracture.geometry.builtin import BUILTIN, builtin
from deepfracture.geometry.distance import (
    Closest,
    closest,
    distance_lattice,
    signed_distance,
    signed_distance_lattice,
    signed_distance_points,
    voxels_inside,
    winding_lattice,
)
from deepfracture.geometry.mass import MassProperties, mass_properties, moments, properties_of
from deepfracture.geometry.normalise import normalise
from deepfracture.geometry.read import check_solid, load_shape, read_mesh, read_triangles
from deepfracture.geometry.remesh import remesh
from deepfracture.geometry.sampled import distance_to_samples
from deepfracture.geometry.topology import Faults, faults

__all__ = [
    "BUILTIN",
    "Closest",
    "Faults",
    "MassProperties",
    "builtin",
    "carried",
    "check_solid",
    "closest",
    "distance_lattice",
    "distance_to_samples",
    "faults",
    "load_shape",
    "mass_properties",
    "moments",
    "normalise",
    "properties_of",
    "read_mesh",
    "read_triangles",
    "remesh",
    "signed_distance",
    "signed_distance_lattice",
    "signed_distance_points",
    "voxels_inside",
    "winding_lattice",
]
