"""`play`: break shapes in the browser."""

from __future__ import annotations

import logging
from pathlib import Path

from deepfracture.runtime.progress import log


def play(
    shape: str | None, *, model: Path | None, up: str | None, host: str, port: int, upload_limit: float, most_tabs: int
) -> None:
    """Serve the page until Ctrl+C."""
    from deepfracture.play import Options, serve

    log.setLevel(logging.WARNING)  # the stages of each shot are on the page
    serve(Options(shape, model, up, host, port, int(upload_limit * 1e6), most_tabs))
