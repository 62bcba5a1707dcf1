"""Hands results on: animated glTF and USD, fragment meshes, film and pictures."""

from .film import write_film
from .gltf import write_glb
from .meshes import write_fragments
from .picture import before_hit_after, exploded
from .sequence import write_sequence
from .usd import write_usd

__all__ = ["before_hit_after", "exploded", "write_film", "write_fragments", "write_glb", "write_sequence", "write_usd"]
