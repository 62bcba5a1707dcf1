"""A hundred shots at one shape: how fragments depend on the blow, in one picture and a table.

python examples/07_many_shots_statistics.py --shape mug --shots 100
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from starting import start

import deepfracture as df
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log, track
from deepfracture.types import Floats


def many_shots(
    shape: str = "pot",
    *,
    shots: int = 100,
    impulse: tuple[float, float] = (400.0, 4000.0),
    breaker: str = "learned",
    resolution: int = 64,
    out: Path = Path("runs/07_many_shots_statistics"),
    seed: int = 0,
) -> None:
    """Shoot at one shape from all sides; writes shots.csv and shots.png.

    Args:
        shape: a built-in name or a mesh file.
        shots: how many.
        impulse: weakest and strongest blow [N s].
        breaker: how it breaks.
        resolution: voxels along each axis, for physical and voronoi.
        out: folder.
        seed: of the shots.
    """
    if shots < 2 or not 0 < impulse[0] < impulse[1]:
        raise df.BadInput(f"shots must be at least 2 and impulse positive and rising, got {shots} and {impulse}")
    body = df.load(shape)
    breaks = df.breaker(breaker, body, resolution=resolution)
    rng = np.random.default_rng(seed)
    rows, volumes = [], []
    for number in track(range(shots), name="shots"):
        blow = random_blow(body, float(rng.uniform(*impulse)), rng)
        fragments = breaks(body, blow, rng)
        shares = sorted((piece.volume / body.mesh.volume for piece in fragments or ()), reverse=True) or [1.0]
        rows.append((number, float(blow.magnitude[0]), *blow.position[0], len(shares), shares[0]))
        volumes += shares if fragments else []
    if not volumes:
        raise df.BadInput(f"none of {shots} shots broke {shape}; raise --impulse")
    with atomic_file(out / "shots.csv") as temporary:
        temporary.write_text(as_csv(rows), encoding="utf-8")
    draw(rows, np.array(volumes), f"{body.name}, {breaker}, {shots} shots", out / "shots.png")
    counts = np.array([row[5] for row in rows])
    log.info("%d of %d broke; fragments %d to %d, median %g", (counts > 1).sum(), shots, counts.min(), counts.max(),
             np.median(counts))  # fmt: skip


def random_blow(body: df.Shape, impulse: float, rng: np.random.Generator) -> df.Impact:
    """From anywhere, straight in."""
    direction = rng.standard_normal(3)
    return df.hit(body, 2 * direction / np.linalg.norm(direction), impulse=impulse, speed=10)


def as_csv(rows: list[tuple]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("shot", "impulse_Ns", "x_m", "y_m", "z_m", "fragments", "largest_share"))
    table.writerows(rows)
    return text.getvalue()


def draw(rows: list[tuple], volumes: Floats, title: str, path: Path) -> None:
    """Fragments and the largest one against the impulse, and how large fragments are."""
    from matplotlib.figure import Figure

    _, impulses, *_, counts, largest = zip(*rows, strict=True)
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    figure.suptitle(title)
    left, middle, right = figure.subplots(1, 3)
    left.plot(impulses, counts, "o", ms=3.5, color="#a04a2c")
    left.set(xlabel="impulse [N s]", ylabel="fragments", ylim=(0, None))
    middle.plot(impulses, largest, "o", ms=3.5, color="#3e4854")
    middle.set(xlabel="impulse [N s]", ylabel="largest fragment, share of the volume", ylim=(0, 1.03))
    right.hist(volumes, bins=np.geomspace(volumes.min(), 1, 24).tolist(), color="#c9a27e")
    right.set(xlabel="share of the volume", ylabel="fragments of all shots", xscale="log")
    with atomic_file(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100)


if __name__ == "__main__":
    start(many_shots)
