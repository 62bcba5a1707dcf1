"""How alike two ways of breaking are: what describes a pattern, and how far two descriptions are apart."""

from deepfracture.compare.distances import MEASURES, distances
from deepfracture.compare.information import variation_of_information
from deepfracture.compare.traits import Traits, traits_of

__all__ = ["MEASURES", "Traits", "distances", "traits_of", "variation_of_information"]
