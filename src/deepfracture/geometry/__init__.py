"""Shapes: made, read, repaired, normalised, measured."""

from deepfracture.geometry.appearance import fragment_appearance
from deepfracture.geometry.builtin import BUILTIN, builtin
from deepfracture.geometry.distance import (
    ClosestPoints,
    closest_points,
    distance_lattice,
    signed_distance,
    signed_distance_lattice,
    signed_distance_points,
    voxels_inside,
    winding_lattice,
)
from deepfracture.geometry.load import load_shape
from deepfracture.geometry.mass import MassProperties, mass_properties, moments, properties_from_moments
from deepfracture.geometry.normalise import normalise
from deepfracture.geometry.oriented_points import distance_to_oriented_points
from deepfracture.geometry.read import check_solid, read_mesh, read_triangles
from deepfracture.geometry.remesh import remesh
from deepfracture.geometry.topology import MeshDefects, mesh_defects

__all__ = [
    "BUILTIN",
    "ClosestPoints",
    "MassProperties",
    "MeshDefects",
    "builtin",
    "check_solid",
    "closest_points",
    "distance_lattice",
    "distance_to_oriented_points",
    "fragment_appearance",
    "load_shape",
    "mass_properties",
    "mesh_defects",
    "moments",
    "normalise",
    "properties_from_moments",
    "read_mesh",
    "read_triangles",
    "remesh",
    "signed_distance",
    "signed_distance_lattice",
    "signed_distance_points",
    "voxels_inside",
    "winding_lattice",
]
