"""Carving: fracture pattern to GS-SDF, GS-SDF to fragments, fragments out of the original mesh."""

from deepfracture.carve.cracks import distance_to_cracks, voronoi_pattern
from deepfracture.carve.cut import cut
from deepfracture.carve.encode import encode
from deepfracture.carve.segment import segment

__all__ = ["cut", "distance_to_cracks", "encode", "segment", "voronoi_pattern"]
