"""`soak`: thousands of random hits, each checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deepfracture.runtime.progress import log


def soak(*, hits: int, out: Path | None, workers: int, limit: float, **options: Any) -> bool:
    """Hit and check, log a summary; returns whether all hits passed. `options`: the fields of `SoakOptions`."""
    from deepfracture.runtime.files import atomic_file
    from deepfracture.soak import SoakOptions, summary
    from deepfracture.soak import soak as run
    from deepfracture.soak.results import sound

    chosen = SoakOptions(**options)
    rows = run(chosen, hits, out=out, workers=workers, limit=limit)
    text = summary(rows, chosen)
    log.info("%s", text.rstrip())
    if out is not None:
        with atomic_file(out / "summary.md") as temporary:
            temporary.write_text(text, encoding="utf-8")
    return sound(rows)
