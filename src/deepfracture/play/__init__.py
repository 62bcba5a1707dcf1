"""A page on this machine on which one shoots at things: `deepfracture play`."""

from deepfracture.play.server import Options, page, serve

__all__ = ["Options", "page", "serve"]
