"""Files and folders that appear whole or not at all: see `deepfracture.files`."""

from ..files import replacing, replacing_folder

__all__ = ["replacing", "replacing_folder"]
