"""`soak`: thousands of random hits, each checked."""

from __future__ import annotations

from pathlib import Path

from deepfracture.runtime.progress import log


def soak(
    shapes: tuple[str, ...], *, hits: int, breakers: tuple[str, ...], seed: int, out: Path | None, workers: int,
    limit: float, resolution: int | None, engine: str, model: Path | None, data: Path | None, repair: bool,
) -> bool:  # fmt: skip
    """Hit and check, log a summary; returns whether all hits passed."""
    from deepfracture.runtime.files import atomic_file
    from deepfracture.soak import SoakOptions, summary
    from deepfracture.soak import soak as run
    from deepfracture.soak.results import sound

    options = SoakOptions(
        shapes, breakers, seed, resolution, engine, repair, model=model, data=data,
    )  # fmt: skip
    rows = run(options, hits, out=out, workers=workers, limit=limit)
    text = summary(rows, options)
    log.info("%s", text.rstrip())
    if out is not None:
        with atomic_file(out / "summary.md") as temporary:
            temporary.write_text(text, encoding="utf-8")
    return sound(rows)
