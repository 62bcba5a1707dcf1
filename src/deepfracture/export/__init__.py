"""Exports results: animated glTF and USD, a page, fragment meshes, sequences; `formats.FORMATS` lists them all."""

from deepfracture.export.formats import FORMATS, check_formats, format_for, write_formats
from deepfracture.export.gltf import write_glb
from deepfracture.export.meshes import write_fragments
from deepfracture.export.page import write_page
from deepfracture.export.sequence import write_sequence
from deepfracture.export.usd import write_usd

__all__ = [
    "FORMATS",
    "check_formats",
    "format_for",
    "write_formats",
    "write_fragments",
    "write_glb",
    "write_page",
    "write_sequence",
    "write_usd",
]
