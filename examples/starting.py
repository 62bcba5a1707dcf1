"""How every example starts: its arguments from the command line, its steps to the terminal, a bad value in one line."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deepfracture import BadInput


def start(example: Callable[..., Any]) -> None:
    """Run a typed function with the arguments that were given."""
    import tyro

    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        tyro.cli(example)
    except BadInput as problem:
        sys.stderr.write(f"{Path(sys.argv[0]).name}: {problem}\n")
        sys.exit(2)
