"""One blow, several ways to break: how they look side by side, and how long each takes.

    python examples/03_compare_breakers.py --shape bunny

`nearest` and `random` recall simulated patterns, so they need a data set: --dataset, made by `deepfracture simulate`.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from picturing import exploded_view, panel
from starting import start

import deepfracture as df
from deepfracture.runtime.progress import log


def compare_breakers(
    shape: str = "bunny",
    *,
    breakers: tuple[str, ...] = ("physical", "learned", "cvd", "voronoi"),
    out: Path = Path("runs/03_compare_breakers"),
    impulse: float = 3000,
    dataset: Path | None = None,
    resolution: int = 64,
    size: tuple[int, int] = (420, 360),
    seed: int = 0,
) -> None:
    """Break one shape by one blow in several ways, and draw the fragments.

    Args:
        shape: a built-in name or a mesh file.
        breakers: ways to break it.
        out: folder of breakers.png.
        impulse: of the blow [N s].
        dataset: simulated patterns for nearest, random and cvd.
        resolution: voxels along each axis.
        size: width and height of each picture [pixel].
        seed: the same seed breaks the same way.
    """
    body = df.load(shape)
    blow = df.hit(body, point=(0.2, -3, 0.1), direction=(0, 1, 0), impulse=impulse, speed=12)
    views = []
    for name in breakers:
        breaker = df.breaker(name, body, dataset=dataset, resolution=resolution)
        breaker(body, blow, np.random.default_rng(seed))  # the first call prepares the shape
        begin = time.perf_counter()
        fragments = breaker(body, blow, np.random.default_rng(seed))
        seconds = time.perf_counter() - begin
        if fragments is None:
            raise df.BadInput(f"{impulse:g} N s do not break {shape} with {name}; raise --impulse")
        caption = f"{name}: {len(fragments)} fragments, {seconds:.2f} s"
        log.info("%s", caption)
        views.append((exploded_view(fragments, body, size, azimuth=-70), caption))
    panel(views, out / "breakers.png")


if __name__ == "__main__":
    start(compare_breakers)
