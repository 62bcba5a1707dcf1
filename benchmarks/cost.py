"""What a hit costs against boundary elements, resolution and cracks: writes the report and its pictures.

    python benchmarks/cost.py ../shared/data/squirrel.obj

takes some fifteen minutes on two cores that have nothing else to do. Any mesh file or built-in shape will do."""

from __future__ import annotations

import argparse
import logging
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepfracture.bench import Row, bench, table
from deepfracture.bench.fracture import MATERIAL, HitCost, empty_cache, hit_cost
from deepfracture.bench.hits import SPEEDS, random_hits
from deepfracture.bench.rows import share
from deepfracture.fracture import FractureBody, material, prepare_body
from deepfracture.fracture.body import ELEMENTS
from deepfracture.geometry import load_shape
from deepfracture.runtime.memory import peak_mb
from deepfracture.runtime.progress import collect_stages, log
from deepfracture.types import Grid, Shape

DOCS = Path(__file__).parents[1] / "docs"
COUNTS = (500, 1000, 1500, 2000, 3000)
"""Boundary elements asked for."""
RESOLUTIONS = (32, 64, 128, 256)
RESOLUTION = 128
FEW = 4
"""Hits whose median counts for each number of elements and each resolution."""
MANY = 24
"""Hits of the plot against cracks ..."""
FAST = (SPEEDS[0], 2 * SPEEDS[1])
"""... with balls of up to twice the usual speed [m/s]."""


@dataclass(frozen=True)
class Point:
    """One size of the problem, and what it costs."""

    size: float
    """Elements, or voxels along an axis."""
    set_up: float
    """Seconds of the part of the set-up that grows with it."""
    hit: float
    """Seconds of a hit, in the median."""
    part: float
    """Seconds of the part of the hit that grows with it, in the median."""
    peak_mb: float


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure what a hit costs; write docs/reports/performance.md.")
    parser.add_argument("shape", nargs="?", default="pot", help="a mesh file, or a built-in shape")
    arguments = parser.parse_args()
    logging.basicConfig(format="%(message)s")
    shape, load = load_shape(arguments.shape), os.getloadavg()[0]
    pictures = DOCS / "images" / "bench"
    pictures.mkdir(parents=True, exist_ok=True)
    rows = bench("fracture", shape, RESOLUTION)
    log.warning("%s", table(rows))
    scatter = costs(prepare_body(shape, material(MATERIAL), Grid(RESOLUTION)), MANY, FAST)
    elements, resolutions = against_elements(shape), against_resolution(shape)
    _draw_shares(rows, pictures / "shares.png")
    _draw_sizes(elements, "boundary elements", ("assembly and factor", "elastic stage"), pictures / "elements.png")
    _draw_sizes(resolutions, "voxels along an axis", ("distances", "fragments"), pictures / "resolution.png")
    _draw_cracks(scatter, pictures / "cracks.png")
    _write(
        DOCS / "reports" / "performance.md",
        _page(Path(arguments.shape).name, shape, load, rows, scatter, elements, resolutions),
    )


def costs(body: FractureBody, count: int, speeds: tuple[float, float]) -> list[HitCost]:
    """What random hits of a body cost, after one that does not count."""
    impacts = random_hits(body.shape, body.material, count, speeds=speeds)
    hit_cost(body, impacts[0], 0)
    return [hit_cost(body, impact, seed) for seed, impact in enumerate(impacts)]


def against_elements(shape: Shape) -> list[Point]:
    """The boundary elements: their set-up, and the elastic stage of a hit."""
    points = []
    for count in COUNTS:
        with empty_cache(), collect_stages() as stages:
            body = prepare_body(shape, material(MATERIAL), Grid(RESOLUTION), elements=count)
        set_up = sum(done.seconds for done in stages if done.stage == "boundary elements")
        points.append(_point(len(body.elastic.mesh.faces), set_up, costs(body, FEW, SPEEDS), "elastostatics"))
    return points


def against_resolution(shape: Shape) -> list[Point]:
    """The lattice: its distances, and the fragments of a hit."""
    points = []
    for resolution in RESOLUTIONS:
        with empty_cache(), collect_stages() as stages:
            body = prepare_body(shape, material(MATERIAL), Grid(resolution))
        set_up = sum(done.seconds for done in stages if done.stage == "distances")
        points.append(_point(resolution, set_up, costs(body, FEW, SPEEDS), "fragments"))
    return points


def _point(size: float, set_up: float, hits: Sequence[HitCost], part: str) -> Point:
    whole = float(np.median([hit.seconds for hit in hits]))
    return Point(size, set_up, whole, float(np.median([hit.stages.get(part, 0.0) for hit in hits])), peak_mb())


def _axes(x: str, y: str):
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(5.2, 3.6), layout="constrained")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)
    return figure, axes


def _save(figure, path: Path) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.png")
    figure.savefig(temporary, dpi=120)
    os.replace(temporary, path)


def _draw_shares(rows: Sequence[Row], path: Path) -> None:
    parts = [(row.stage.split(" / ")[1], row.seconds) for row in rows if share(row, rows) is not None]
    figure, axes = _axes("seconds of a median hit", "")
    names, spent = zip(*reversed(parts), strict=True)
    axes.barh(names, spent)
    _save(figure, path)


def _draw_sizes(points: Sequence[Point], x: str, names: tuple[str, str], path: Path) -> None:
    size = [point.size for point in points]
    figure, axes = _axes(x, "seconds")
    axes.loglog(size, [point.set_up for point in points], "s--", label=f"set-up: {names[0]}")
    axes.loglog(size, [point.hit for point in points], "o-", label="hit")
    axes.loglog(size, [point.part for point in points], "^:", label=f"hit: {names[1]}")
    axes.set_xticks(size, [f"{n:g}" for n in size])
    axes.minorticks_off()
    axes.legend()
    _save(figure, path)


def _draw_cracks(hits: Sequence[HitCost], path: Path) -> None:
    figure, axes = _axes("cracks", "seconds of a hit")
    axes.plot([hit.cracks for hit in hits], [hit.seconds for hit in hits], "o")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    _save(figure, path)


def _slope(x: Sequence[float], y: Sequence[float]) -> float:
    """The exponent p of y ~ x^p over the two largest sizes, where what does not grow matters least."""
    return float(np.log(y[-1] / y[-2]) / np.log(x[-1] / x[-2]))


def _per_crack(hits: Sequence[HitCost]) -> tuple[float, float]:
    """Seconds of a crack and of a hit without any, by least squares."""
    slope, rest = np.polyfit([hit.cracks for hit in hits], [hit.seconds for hit in hits], 1)
    return float(slope), float(rest)


def _machine() -> str:
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return f"{os.cpu_count()} cores ({platform.machine()}), {memory:.0f} GB, no GPU, Python {platform.python_version()}"


def _points_table(points: Sequence[Point], head: tuple[str, str, str]) -> list[str]:
    lines = [f"| {head[0]} | {head[1]} [s] | hit [s] | {head[2]} [s] | peak [MB] |", "|---|---|---|---|---|"]
    return lines + [f"| {p.size:g} | {p.set_up:.2f} | {p.hit:.2f} | {p.part:.2f} | {p.peak_mb:.0f} |" for p in points]


def _rows_table(rows: Sequence[Row]) -> list[str]:
    lines = ["| stage | seconds | share of a hit | peak [MB] |", "|---|---|---|---|"]
    for row in rows:
        part = share(row, rows)
        lines.append(
            f"| {row.stage} | {row.seconds:.3f} | {'' if part is None else f'{part:.0%}'} | {row.peak_mb:.0f} |"
        )
    return lines


def _page(
    file: str, shape: Shape, load: float, rows: Sequence[Row], hits: Sequence[HitCost],
    elements: Sequence[Point], lattices: Sequence[Point],
) -> str:  # fmt: skip
    whole = next(row for row in rows if row.stage == "hit")
    theirs = f" {whole.reference} takes {whole.reference_seconds:g} s for one." if whole.reference else ""
    crack, rest = _per_crack(hits)
    grown = _slope([p.size for p in elements], [p.set_up for p in elements])
    wider = _slope([p.size for p in lattices], [p.hit for p in lattices])
    return "\n".join(
        [
            "# Performance",
            "",
            f"Measured on {_machine()}, by",
            f"`python benchmarks/cost.py {file}`, which writes this page;",
            f"{len(shape.mesh.faces)} triangles, {MATERIAL}, r = {RESOLUTION} and {ELEMENTS} boundary elements unless",
            "said otherwise. The kernels are compiled beforehand (`deepfracture warm`).",
            "`deepfracture bench` prints the same figures for your machine and shape; `make bench` records them in",
            "`runs/bench` with the machine and the date, and marks what takes 1.25 times as long as in the last one.",
            "[Profiles](profiles.md) of the slowest parts list the functions. Load of the machine at the start, from",
            f"other jobs: {load:.1f} on average; with any load the seconds are upper bounds.",
            "",
            "## A body, and a hit",
            "",
            "The set-up belongs to the shape and is kept on disk. A hit is the median of random collisions at",
            f"{SPEEDS[0]:g} to {SPEEDS[1]:g} m/s: {whole.seconds:.2f} s.{theirs}",
            "",
            *_rows_table(rows),
            "",
            "![Seconds of each stage of a hit](../images/bench/shares.png)",
            "",
            "Stages inside another stage count in both. Peak memory is that of the process so far.",
            "",
            "## Against boundary elements",
            "",
            f"Assembly and factor grow with N to the power {grown:.1f} over the two largest; a hit hardly notices.",
            "",
            *_points_table(elements, ("elements", "assembly and factor", "elastic stage")),
            "",
            "![Seconds against boundary elements](../images/bench/elements.png)",
            "",
            "## Against resolution",
            "",
            f"A hit grows with r to the power {wider:.1f} over the two largest: the lattice of stress stays as it is.",
            "",
            *_points_table(lattices, ("r", "distances", "fragments")),
            "",
            "![Seconds against resolution](../images/bench/resolution.png)",
            "",
            "## Against cracks",
            "",
            f"{len(hits)} hits with balls of {FAST[0]:g} to {FAST[1]:g} m/s:",
            f"{rest:.2f} s, and {crack:.3f} s more for each crack.",
            "",
            "![Seconds against cracks](../images/bench/cracks.png)",
            "",
        ]
    )


def _write(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)


if __name__ == "__main__":
    main()
