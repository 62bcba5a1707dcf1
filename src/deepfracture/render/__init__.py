"""The software renderer: pictures and film without a graphics driver."""

from deepfracture.render.film import write_film
from deepfracture.render.picture import before_hit_after, exploded

__all__ = ["before_hit_after", "exploded", "write_film"]
