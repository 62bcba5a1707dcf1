"""Exports results: animated glTF and USD, fragment meshes, sequences."""

from deepfracture.export.gltf import write_glb
from deepfracture.export.meshes import write_fragments
from deepfracture.export.sequence import write_sequence
from deepfracture.export.usd import write_usd

__all__ = ["write_fragments", "write_glb", "write_sequence", "write_usd"]
