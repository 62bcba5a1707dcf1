"""Shows a recording in the browser."""

from deepfracture.viewer.bodies import add_floor, add_surface
from deepfracture.viewer.page import write_page

__all__ = ["add_floor", "add_surface", "write_page"]
