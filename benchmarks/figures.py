"""Draws the figures of docs/explanation/how_it_works.md: from an impact to its fragments, on our own data.

    python benchmarks/figures.py

`physical`: stress, cracks, segmented distance field, fragments of one simulated collision. `learned`: the same way
through the network, from the impulse over its code to the fragments. `codes`: one blow, four random codes. `impulses`:
one place, ever harder blows. Sections show the plane y = 0, x to the right and z up.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from harness import ROOT, exploded_view, row_of_axes, save_figure, start
from numpy.typing import NDArray

import deepfracture as df
from deepfracture.carve import cut, encode, segment
from deepfracture.fracture import prepare_body
from deepfracture.fracture import simulate as fracture
from deepfracture.geometry import signed_distance
from deepfracture.learn import PartitionModel, embedded_model, load_partition_model
from deepfracture.learn.codes import encode_impulses
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log
from deepfracture.types import Floats, Fragments, Grid, Impact, Shape, Volume

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHAPE, MATERIAL = "pot", "plaster"
POINT, DIRECTION = (3.0, 0.0, 0.15), (-1.0, 0.0, -0.1)
IMPULSE, SPEED = 2800.0, 11.0
"""[N s], [m/s]"""
IMPULSES = (700.0, 1500.0, 2500.0, 3800.0)
LOAD_STEPS = 10
SCALE = 0.12
"""Distance [m] at which the colours of a distance field end."""


def figures(
    only: tuple[str, ...] = (),
    resolution: int = 128,
    dpi: int = 90,
    view: tuple[int, int] = (420, 400),
    out: Path = ROOT / "docs" / "images" / "how",
) -> list[Path]:
    """Draw them; returns their paths.

    Args:
        only: names of figures; none: all.
        resolution: voxels along each axis.
        dpi: pixels to an inch.
        view: width and height of an exploded view [pixel].
        out: folder.
    """
    unknown = [name for name in only if name not in FIGURES]
    if unknown:
        raise df.BadInput(f"{unknown[0]!r}: no such figure; there are {', '.join(FIGURES)}")
    shape = df.load(SHAPE)
    done = []
    for name in only or FIGURES:
        figure = FIGURES[name](shape, resolution, view)
        path = out / f"{name}.png"
        save_figure(figure, path, dpi)
        _fewer_colours(path)
        log.warning("%s: %.0f kB", path.name, path.stat().st_size / 1e3)
        done.append(path)
    return done


def blow(shape: Shape, impulse: float = IMPULSE) -> Impact:
    """What all figures show."""
    return df.hit(shape, POINT, DIRECTION, impulse=impulse, speed=SPEED)


def physical(shape: Shape, resolution: int, view: tuple[int, int]) -> Any:
    """Stress over strength without a crack, the fragments, their distance field, and what is cut of it."""
    from deepfracture.fracture.simulate import _initial_state
    from deepfracture.fracture.variation import Variation

    impact, material = blow(shape), df.material(MATERIAL)
    body = prepare_body(shape, material, Grid(resolution))
    variation = Variation.draw(material, body.coarse, np.random.default_rng(0))
    state = _initial_state(body, impact, variation, contact=True)
    for _ in range(LOAD_STEPS):
        state.advance(state.load.rise / LOAD_STEPS)
    share = np.full(body.coarse.shape, np.nan)
    share[tuple(body.cells.T)] = state.tension / state.strength
    cracking = fracture(body, impact, np.random.default_rng(0))
    if cracking is None:
        raise df.BadInput(f"an impulse of {IMPULSE:g} N s breaks nothing; draw another blow")
    volume = encode(cracking.pattern, signed_distance(shape.mesh, Grid(resolution)))
    fragments = cut(shape, cracking.pattern, density=material.density)
    figure, axes = _row(4)
    half = body.coarse.spacing * body.coarse.shape[0] / 2
    shown = axes[0].imshow(
        share[:, share.shape[1] // 2].T, origin="lower", extent=(-half, half, -half, half), cmap="magma_r", vmin=0
    )
    figure.colorbar(shown, ax=axes[0], shrink=0.7)
    _arrow(axes[0], impact)
    _labels(axes[1], cracking.pattern.labels)
    _field(figure, axes[2], volume)
    axes[3].imshow(_exploded(fragments, shape, view))
    names = ("tension / strength at peak load,\nif nothing cracked", f"{cracking.pattern.count} fragments on the grid")
    _titles(axes, (*names, "GS-SDF: distance to the nearest\nboundary, negative outside [m]", "the mesh, cut"))
    return figure


def learned(shape: Shape, resolution: int, view: tuple[int, int]) -> Any:
    """Impulse, code, the patterns that are asked, predicted field, segments, fragments."""
    model = _model(shape, resolution)
    impact = blow(shape)
    rng = np.random.default_rng(0)
    rows = model.normaliser(impact).astype(np.float32)
    random = np.random.default_rng(0).standard_normal(model.config.segment_size, np.float32)
    code = encode_impulses(model.weights, rows[None])[0]
    volume = model.predict(impact, rng)
    pattern = segment(volume)
    fragments = cut(shape, pattern, density=df.material(MATERIAL).density)
    figure, axes = _row(5)
    strip = np.concatenate([code, np.full((-len(code)) % 16, np.nan)]).reshape(-1, 16)
    axes[0].imshow(strip, cmap="coolwarm", vmin=-1, vmax=1)
    axes[0].set(xticks=[], yticks=[])
    _memory(axes[1], model, rows, random)
    _field(figure, axes[2], volume)
    _arrow(axes[2], impact)
    _labels(axes[3], pattern.labels)
    axes[4].imshow(_exploded(fragments, shape, view))
    first = (f"the impulse as {len(code)} numbers", "training patterns: the most\ntypical of similar blows answers")
    _titles(axes, (*first, "predicted GS-SDF [m]", f"segments: {pattern.count}", "the mesh, cut"))
    return figure


def codes(shape: Shape, resolution: int, view: tuple[int, int]) -> Any:
    """One blow, four random codes."""
    model = _model(shape, resolution)
    found = [segment(model.predict(blow(shape), np.random.default_rng(seed))) for seed in (0, 1, 2, 5)]
    return _views(shape, found, [f"random code {k + 1}: {p.count} fragments" for k, p in enumerate(found)], view)


def impulses(shape: Shape, resolution: int, view: tuple[int, int]) -> Any:
    """One place, ever harder."""
    model = _model(shape, resolution)
    found = [segment(model.predict(blow(shape, impulse), np.random.default_rng(0))) for impulse in IMPULSES]
    names = [f"{impulse:.0f} N s: {p.count} fragments" for impulse, p in zip(IMPULSES, found, strict=True)]
    return _views(shape, found, names, view)


FIGURES: dict[str, Callable[[Shape, int, tuple[int, int]], Any]] = {
    "physical": physical,
    "learned": learned,
    "codes": codes,
    "impulses": impulses,
}


def _model(shape: Shape, resolution: int) -> PartitionModel:
    path = embedded_model(shape.name)
    assert path is not None, "the pot's model ships with the program"
    return load_partition_model(path).at(shape, resolution)


def _views(shape: Shape, patterns: list[df.FracturePattern], names: list[str], view: tuple[int, int]) -> Any:
    figure, axes = _row(len(patterns))
    for axis, pattern in zip(axes, patterns, strict=True):
        axis.imshow(_exploded(cut(shape, pattern, density=1000.0), shape, view))
    _titles(axes, names)
    return figure


def _row(count: int) -> tuple[Figure, list[Axes]]:
    return row_of_axes(count, (3.1 * count, 3.3))


def _titles(axes: list[Axes], names: list[str] | tuple[str, ...]) -> None:
    for axis, name in zip(axes, names, strict=True):
        axis.set_title(name, fontsize=10)
        if axis.images and axis.images[0].get_array().ndim == 3:  # a picture, not a section
            axis.axis("off")
        if axis.get_aspect() == 1 and axis.get_xlim()[0] == -axis.get_xlim()[1]:  # a section
            axis.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), xticks=(-1, 0, 1), yticks=(-1, 0, 1))
        axis.tick_params(labelsize=7)


def _section(values: NDArray) -> NDArray:
    """The plane y = 0 with z up."""
    return values[:, values.shape[1] // 2].T


def _labels(axis: Axes, labels: NDArray) -> None:
    from matplotlib.colors import ListedColormap

    colours = np.random.default_rng(4).uniform(0.35, 0.95, (int(labels.max()) + 1, 3))
    colours[0] = 1
    section = _section(labels)
    axis.imshow(
        section, origin="lower", extent=(-1, 1, -1, 1), cmap=ListedColormap(colours.tolist()), vmin=-0.5,
        vmax=len(colours) - 0.5, interpolation="nearest",
    )  # fmt: skip


def _field(figure: Any, axis: Axes, volume: Volume) -> None:
    section = _section(volume.values)
    shown = axis.imshow(section, origin="lower", extent=(-1, 1, -1, 1), cmap="RdBu", vmin=-SCALE, vmax=SCALE)
    axis.contour(section, [0], extent=(-1, 1, -1, 1), colors="black", linewidths=0.8)
    figure.colorbar(shown, ax=axis, shrink=0.7)


def _arrow(axis: Axes, impact: Impact) -> None:
    (x, _, z), (dx, _, dz) = impact.position[0], impact.direction[0]
    arrow = {"arrowstyle": "-|>", "color": "black", "lw": 1.6}
    axis.annotate("", (x, z), (x - 0.4 * dx, z - 0.4 * dz), arrowprops=arrow)


def _memory(axis: Axes, model: PartitionModel, rows: Floats | NDArray, random: NDArray) -> None:
    """How alike the blow of each training pattern is, against how far its code is from what could happen."""
    alike = model.selector.kernel(model.selector.impulses, rows)
    order = model.selector(rows, random)
    rank = np.empty(len(order))
    rank[order] = np.arange(1, len(order) + 1)
    axis.plot(rank, alike, "o", ms=3, color="#c9a27e")
    axis.plot(rank[order[0]], alike[order[0]], "*", ms=13, color="#a04a2c")
    axis.set(xlabel="rank as an answer", ylabel="similarity of its blow", xscale="log", box_aspect=0.85)
    axis.xaxis.label.set_size(8)
    axis.yaxis.label.set_size(8)


def _exploded(fragments: Fragments, shape: Shape, size: tuple[int, int]) -> NDArray[np.uint8]:
    return exploded_view(fragments, shape, size, azimuth=-40.0, factor=0.35)


def _fewer_colours(path: Path) -> None:
    """Figures stay small: 255 colours are enough for them."""
    from PIL import Image

    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(255, dither=Image.Dither.NONE)
    with atomic_file(path) as temporary:
        small.save(temporary, format="PNG", optimize=True)


if __name__ == "__main__":
    start(figures)
