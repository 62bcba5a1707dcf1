"""Writes docs/reports/statistics.md: fragments against the impulse, and their size distribution.

Four questions, for each shape:
- Does the number of fragments rise with the impulse? Spearman's rank correlation with a bootstrap interval; a
  collision that broke nothing counts as one fragment.
- Does the share of small fragments among those near the hit rise with it? Near: the fragment's centre lies within
  --near of the strongest contact. Small: smaller than --small times the mean volume of all fragments of all the
  shape's collisions, so that the measure is one for the shape and does not shrink with the fragments themselves. A
  collision with no fragment near the hit, or that broke nothing, has the share zero.
- Does more of the body near the hit end up in small pieces? The share of the volume within --near of the strongest
  contact that belongs to fragments below --piece of the body's volume. Unlike the share above it weighs pieces by
  their size, and a large fragment counts where it is, not where its centre lies.
- Are volumes distributed as Mott found, P(V) = exp(-(6 V / V_mean)^(1/3)) the share of fragments larger than V (Mott
  and Linfoot 1943; the paper's figure)? V_mean is each collision's own; the distances of Kolmogorov and Smirnov are
  also given for FractureRB's volumes. The simulator joins pieces of fewer than 64 voxels to a neighbour: below that
  volume there is nothing, which the distance includes.

Volumes are counted in voxels.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from harness import (
    DATA,
    REFERENCE,
    ROOT,
    SPEEDS,
    fragment_volumes,
    row_of_axes,
    save_figure,
    shape_named,
    start,
    table,
    write_json,
    write_text,
)

from deepfracture.dataset import Dataset, Sample, SimulateOptions, open_dataset, simulate_collisions
from deepfracture.fracture import material
from deepfracture.runtime.progress import log, track
from deepfracture.types import BadInput, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHAPES = ("pot", "squirrel", "bunny", "bar")
WANTED = 0.6
"""Rank correlation with the impulse that the simulator must reach."""
RESAMPLES = 2000
CONFIDENCE = 0.95
INK, PALE, ACCENT = "#33414d", "#b9c3ca", "#bd5e3d"


@dataclass(frozen=True, eq=False)
class Collisions:
    """What is measured on the collisions of one shape."""

    name: str
    impulse: Floats
    """[N s], shape (n,)."""
    count: Floats
    """Fragments, 1 where nothing broke, shape (n,)."""
    small: Floats
    """Share of small fragments among those near the hit, shape (n,)."""
    shattered: Floats
    """Share of the volume near the hit that is in small pieces, shape (n,)."""
    volumes: tuple[Floats, ...]
    """Fragment volumes [m^3] of each collision that broke the shape."""


@dataclass(frozen=True)
class Correlation:
    """Spearman's rank correlation and its bootstrap interval."""

    rho: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.rho:.2f} ({self.low:.2f} to {self.high:.2f})"


def collision_statistics(
    shapes: tuple[str, ...] = SHAPES,
    datasets: tuple[Path, ...] = (),
    collisions: int = 60,
    resolution: int = 128,
    preset: str = "plaster",
    speed: tuple[float, float] = SPEEDS,
    near: float = 0.5,
    small: float = 0.1,
    piece: float = 0.1,
    workers: int = 2,
    seed: int = 0,
    data: Path = DATA,
    reference: Path = REFERENCE,
    out: Path = ROOT / "runs" / "statistics",
    docs: Path = ROOT / "docs",
) -> Path:
    """Correlations with the impulse and Mott's distribution; writes statistics.md, statistics.json and plots.

    Args:
        shapes: built-in names, or names of .obj files in --data; absent ones are skipped.
        datasets: folders made by `deepfracture simulate`, read instead of simulating --shapes.
        collisions: balls thrown at each shape.
        resolution: voxels along each axis.
        preset: the whole-material preset.
        speed: slowest and fastest ball [m/s].
        near: fragments whose centre is this near to the hit count as near [m].
        small: fragments below this share of the shape's mean fragment volume count as small.
        piece: fragments below this share of the body's volume are small in the measure by volume.
        workers: processes.
        seed: of the collisions, and of the bootstrap.
        data: folder of meshes.
        reference: folder with fracturerb_volumes.json.
        out: folder of the data sets; run again to go on.
        docs: folder for reports/statistics.md, reports/statistics.json and images/statistics/SHAPE.png.
    """
    sets = [open_dataset(path) for path in datasets]
    for name in () if sets else shapes:
        shape = shape_named(name, data)
        if shape is not None:
            folder = out / f"{shape.name}-{preset}-r{resolution}-{speed[0]:g}-{speed[1]:g}-s{seed}"
            log.warning("%s: %d collisions", shape.name, collisions)
            sets.append(
                simulate_collisions(
                    shape, material(preset), folder,
                    SimulateOptions(collisions, resolution, speed, workers=workers, seed=seed),
                )
            )  # fmt: skip
    if not sets:
        raise BadInput("shapes: none of them is there")
    measured = [measure(dataset, near=near, small=small, piece=piece) for dataset in sets]
    found = {collision.name: figures(collision, seed) for collision in measured}
    paper = fracturerb(reference / "fracturerb_volumes.json")
    for collision in measured:
        _plot(collision, found[collision.name], paper, docs / "images" / "statistics" / f"{collision.name}.png")
    write_json(
        docs / "reports" / "statistics.json",
        {"shapes": found, "fracturerb": {k: mott_distance([v]) for k, v in paper.items()}},
    )
    text = report(found, paper, near, small, piece)
    write_text(docs / "reports" / "statistics.md", text)
    log.warning("%s", text)
    return docs / "reports" / "statistics.md"


def measure(dataset: Dataset, *, near: float, small: float, piece: float) -> Collisions:
    """What the statistics are of; collisions whose ball missed are left out. The limits: see the module."""
    impulses, counts, around, shattered, volumes = [], [], [], [], []
    for sample in track(dataset, name=dataset.shape.name, total=len(dataset)):
        sizes, centres = fragment_volumes(sample.pattern)
        close = np.linalg.norm(centres - sample.impact.position[0], axis=1) < near
        impulses.append(float(sample.impact.magnitude[0]))
        counts.append(len(sizes))
        around.append(sizes[close])
        shattered.append(_shattered(sample, near, piece))
        volumes.append(sizes)
    if not volumes:
        raise BadInput(f"{dataset.path}: no collision broke the shape; nothing to measure")
    limit = small * float(np.concatenate(volumes).mean())
    shares = [float((sizes < limit).mean()) if len(sizes) else 0.0 for sizes in around]
    weak = _unbroken(dataset)
    return Collisions(
        dataset.shape.name,
        np.array(impulses + weak),
        np.array(counts + [1] * len(weak), float),
        np.array(shares + [0.0] * len(weak)),
        np.array(shattered + [0.0] * len(weak)),
        tuple(volumes),
    )


def _shattered(sample: Sample, near: float, piece: float) -> float:
    """Share of the volume near the hit that is in fragments below `piece` of the body."""
    labels, grid = sample.pattern.labels, sample.pattern.grid
    sizes = np.bincount(labels.ravel())
    inside = np.argwhere(labels > 0)
    close = np.linalg.norm(grid.to_world(inside) - sample.impact.position[0], axis=1) < near
    there = sizes[labels[tuple(inside[close].T)]]
    return float((there < piece * len(inside)).mean()) if len(there) else 0.0


def figures(collisions: Collisions, seed: int) -> dict[str, Any]:
    """Everything that the report tells about one shape."""
    rng = np.random.default_rng(seed)
    return {
        "collisions": len(collisions.impulse),
        "broke": len(collisions.volumes),
        "impulse": [float(collisions.impulse.min()), float(collisions.impulse.max())],
        "fragments": [float(q) for q in np.quantile(collisions.count, (0, 0.5, 1))],
        "count_rises": asdict(rank_correlation(collisions.impulse, collisions.count, rng)),
        "small_rises": asdict(rank_correlation(collisions.impulse, collisions.small, rng)),
        "shattered_rises": asdict(rank_correlation(collisions.impulse, collisions.shattered, rng)),
        "mott": mott_distance(collisions.volumes),
        "largest_share": float(np.median([v.max() / v.sum() for v in collisions.volumes])),
    }


def rank_correlation(x: Floats, y: Floats, rng: np.random.Generator) -> Correlation:
    """Spearman's correlation; the interval by resampling pairs (Efron 1979). Zero where one side is constant."""
    picks = rng.integers(0, len(x), (RESAMPLES, len(x)))
    low, high = np.quantile(
        [_spearman(x[pick], y[pick]) for pick in picks], (0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2)
    )
    return Correlation(_spearman(x, y), float(low), float(high))


def mott_larger(size: Floats) -> Floats:
    """Mott's share of fragments larger than `size` = V / V_mean."""
    return np.exp(-np.cbrt(6 * size))


def mott_distance(volumes: Sequence[Floats]) -> float:
    """Kolmogorov-Smirnov distance of the pooled V / V_mean, V_mean of each collision, from Mott's distribution."""
    from scipy.stats import kstest

    pooled = np.concatenate([np.asarray(v, float) / np.mean(v) for v in volumes])
    return float(kstest(pooled, lambda size: 1 - mott_larger(size)).statistic)


def fracturerb(path: Path) -> dict[str, Floats]:
    """The fragment volumes [m^3] of each of FractureRB's runs; none, with a line in the log, without the file."""
    if not path.is_file():
        log.warning("%s is not there: no comparison with FractureRB", path.name)
        return {}
    runs = json.loads(path.read_text(encoding="utf-8"))["runs"]
    return {name: np.array(run["volumes"]) for name, run in runs.items() if len(run["volumes"]) > 1}


def report(found: dict[str, dict[str, Any]], paper: dict[str, Floats], near: float, small: float, piece: float) -> str:
    """statistics.md."""
    head = (
        "shape", "collisions", "broke", "impulse [N s]", "fragments min/median/max", "fragments rise with impulse",
        "small ones near the hit rise", "volume in small ones near the hit rises",
        f"first and last >= {WANTED}", "Mott: KS distance", "largest fragment, median",
    )  # fmt: skip
    rows = []
    for name, about in found.items():
        count, share, shattered = (Correlation(**about[f"{what}_rises"]) for what in ("count", "small", "shattered"))
        low, middle, high = about["fragments"]
        reached = "yes" if min(count.rho, shattered.rho) >= WANTED else "no"
        rows.append((
            name, about["collisions"], about["broke"], "{:.0f} to {:.0f}".format(*about["impulse"]),
            f"{low:g} / {middle:g} / {high:g}", count, share, shattered, reached, f"{about['mott']:.2f}",
            f"{about['largest_share']:.0%}",
        ))  # fmt: skip
    lines = [
        "# Fragment statistics",
        "Made by `python benchmarks/collision_statistics.py`. Rank correlations are Spearman's, with the "
        f"{CONFIDENCE:.0%} interval of {RESAMPLES} bootstrap samples. Small: below {small:g} of the mean volume of all "
        f"fragments of the shape's collisions; near: centre within {near:g} m of the hit. Volume in small ones: the "
        f"share of the volume within {near:g} m of the hit that is in fragments below {piece:g} of the body. Mott: the "
        "largest difference between the share of fragments larger than V and exp(-(6 V / V_mean)^(1/3)), V_mean of "
        "each collision.",
        table(head, rows).rstrip(),
    ]
    if paper:
        names = [(name, len(v), f"{mott_distance([v]):.2f}") for name, v in paper.items()]
        lines.append("The same distance for FractureRB (Hahn and Wojtan 2016), the simulator of the paper:")
        lines.append(table(("run", "fragments", "Mott: KS distance"), names).rstrip())
    lines += [f"![{name}](../images/statistics/{name}.png)" for name in found]
    return "\n\n".join(lines) + "\n"


def _unbroken(dataset: Dataset) -> list[float]:
    """Impulses [N s] of the collisions that broke nothing."""
    return [record.impulse for record in dataset.records if record.kind == "unbroken" and record.impulse is not None]


def _spearman(x: Floats, y: Floats) -> float:
    from scipy.stats import rankdata

    a, b = rankdata(x) - (len(x) + 1) / 2, rankdata(y) - (len(y) + 1) / 2
    spread = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / spread if spread > 0 else 0.0


def _plot(collisions: Collisions, about: dict[str, Any], paper: dict[str, Floats], path: Path) -> None:
    figure, (left, middle, right) = row_of_axes(3, (12, 3.6))
    _scatter(left, collisions, collisions.count, "fragments", Correlation(**about["count_rises"]))
    what = "share of the volume near the hit in small ones"
    _scatter(middle, collisions, collisions.shattered, what, Correlation(**about["shattered_rises"]))
    for name, volumes in paper.items():
        if name.startswith(collisions.name):
            _larger(right, [volumes], PALE, f"FractureRB, KS {mott_distance([volumes]):.2f}")
    _larger(right, collisions.volumes, ACCENT, f"ours, KS {about['mott']:.2f}")
    size = np.geomspace(1e-3, 30, 200)
    right.plot(size, mott_larger(size), color=INK, lw=1, ls="--", label="Mott")
    right.set(xscale="log", yscale="log", ylim=(2e-3, 1.3), xlabel="V / V_mean", ylabel="share of fragments larger")
    right.legend(frameon=False, fontsize=8)
    figure.suptitle(collisions.name)
    save_figure(figure, path)


def _scatter(axes: Axes, collisions: Collisions, values: Floats, what: str, found: Correlation) -> None:
    axes.plot(collisions.impulse, values, "o", color=ACCENT, ms=4, alpha=0.8)
    axes.set(xlabel="impulse [N s]", ylabel=what, title=f"rank correlation {found}")
    axes.title.set_fontsize(9)


def _larger(axes: Axes, volumes: Sequence[Floats], colour: str, label: str) -> None:
    pooled = np.sort(np.concatenate([v / v.mean() for v in volumes]))
    axes.step(pooled, 1 - np.arange(len(pooled)) / len(pooled), where="pre", color=colour, label=label)


if __name__ == "__main__":
    start(collision_statistics)
