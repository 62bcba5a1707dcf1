"""Shows a recording in the browser."""

from .page import write_page

__all__ = ["write_page"]
