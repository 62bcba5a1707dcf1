"""Carving: fracture pattern to GS-SDF, GS-SDF to fragments, fragments out of the original mesh."""

from deepfracture.carve.cutting.cut import cut
from deepfracture.carve.cutting.decimate import decimated
from deepfracture.carve.encode import encode
from deepfracture.carve.segmentation.published import segment_as_published
from deepfracture.carve.segmentation.segment import segment
from deepfracture.carve.voronoi import voronoi_pattern

__all__ = ["cut", "decimated", "encode", "segment", "segment_as_published", "voronoi_pattern"]
