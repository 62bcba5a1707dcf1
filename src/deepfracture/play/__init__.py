"""The interactive page of `deepfracture play`: click an object to throw a ball at it."""

from deepfracture.play.server import Options, page, serve

__all__ = ["Options", "page", "serve"]
