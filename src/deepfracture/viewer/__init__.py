"""Shows a recording in the browser."""

from .bodies import add_floor, add_surface
from .page import write_page

__all__ = ["add_floor", "add_surface", "write_page"]
