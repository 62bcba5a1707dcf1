"""The command line: each command is a typed function over the rooms. Only here are all rooms known."""

from deepfracture.cli.main import main

__all__ = ["main"]
