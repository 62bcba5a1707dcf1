"""Similarity of fracture patterns: descriptors of a pattern, and distances between two descriptions."""

from deepfracture.compare.descriptors import Descriptors, describe
from deepfracture.compare.distances import MEASURES, distances
from deepfracture.compare.partition import variation_of_information

__all__ = ["MEASURES", "Descriptors", "describe", "distances", "variation_of_information"]
