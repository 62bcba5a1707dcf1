"""The command line: each command is a typed function over the rooms, and only this room knows all the others."""

from deepfracture.cli.main import main

__all__ = ["main"]
