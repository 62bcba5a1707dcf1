"""How should a network be shown a fracture pattern? The same small decoder learns four ways in two dimensions.

    python examples/09_flat_study.py --out DIR

Hits of a plate become pictures: labels numbered at random or by place (dice loss), crack lines (binary
cross-entropy), or the unsigned distance to the nearest crack or side (L2). Predictions are turned back into fragments
and compared with held-out patterns. docs/reports/flat_study.md says what came out.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from flat_plate import SMALLEST, Plate, break_plate, cracked, join_small, random_hits
from scipy import ndimage
from scipy.optimize import linear_sum_assignment

from deepfracture.carve import segment
from deepfracture.compare import variation_of_information
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import track
from deepfracture.types import BadInput, Floats, Grid, Labels, Volume

WAYS = ("labels", "labels by place", "lines", "USDF")
COLUMNS = 5
TOLERANCES = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
"""Depths at which the flood may keep regions apart; the best on training hits is used."""
THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
"""Probability of a crack, in the same way."""
TUNED = 24
"""Training hits on which they are chosen."""
BATCH = 16


@dataclass(frozen=True, eq=False)
class Data:
    """Patterns of one seed."""

    hits: Floats
    plates: list[Plate]
    held_hits: Floats
    held: list[Plate]
    again: list[Plate]
    """The held-out hits once more: how far chance alone keeps two patterns apart."""


@dataclass(frozen=True)
class Score:
    """Means over some hits."""

    bits: float
    """Variation of information."""
    count_error: float
    """Difference in the number of fragments over the true number."""


def flat_study(
    out: Path,
    *,
    resolution: int = 64,
    train: int = 120,
    held: int = 24,
    steps: int = 150,
    seeds: int = 2,
    channels: int = 8,
) -> None:
    """Train, measure and draw: writes flat_study.json and flat_study.png.

    Args:
        out: folder.
        resolution: pixels along a side, 32, 64, 128 or 256.
        train: hits to learn from.
        held: hits to be measured on, at least 5.
        steps: of training, the same for every representation.
        seeds: independent repeats, patterns and networks; at least 2.
        channels: features of the network's finest layer.
    """
    if held < COLUMNS or seeds < 2 or train < BATCH:
        raise BadInput(f"held, seeds and train must be at least 5, 2 and {BATCH}, got {held}, {seeds} and {train}")
    grid, runs, shown = Grid(resolution), [], {}
    jobs = [(seed, way) for seed in range(seeds) for way in WAYS]
    for seed, way in track(jobs, name="trainings"):
        if way == WAYS[0]:
            data = _data(np.random.default_rng([seed, 0]), resolution, train, held)
            runs.append(_yardsticks(data))
        rng = np.random.default_rng([seed, 1])
        found, knob, scores = _run(way, data, grid, steps, channels, rng)
        runs[-1][way] = {**scores, "knob": knob}
        if seed == 0:
            shown[way] = found[:COLUMNS]
            truth = data.held[:COLUMNS], data.held_hits[:COLUMNS]
    result = {"summary": _summary(runs), "seeds": runs}
    with atomic_file(out / "flat_study.json") as path:
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    _draw(out / "flat_study.png", *truth, shown, result["summary"])


def _data(rng: np.random.Generator, resolution: int, train: int, held: int) -> Data:
    hits, held_hits = random_hits(train, rng), random_hits(held, rng)
    patterns = [[break_plate(hit, resolution, rng) for hit in each] for each in (hits, held_hits, held_hits)]
    return Data(hits, patterns[0], held_hits, patterns[1], patterns[2])


def _yardsticks(data: Data) -> dict[str, Any]:
    away = ((data.held_hits[:, None] - data.hits[None]) ** 2).sum(axis=-1)
    near = [data.plates[n].labels for n in away.argmin(axis=1)]
    again = [plate.labels for plate in data.again]
    return {
        "same hit again": {"held out": vars(score(again, data.held))},
        "nearest training hit": {"held out": vars(score(near, data.held))},
    }


def score(found: list[Labels], truth: list[Plate]) -> Score:
    """How far fragments are from the true ones."""
    pairs = list(zip(found, (plate.labels for plate in truth), strict=True))
    return Score(
        float(np.mean([variation_of_information(a, b) for a, b in pairs])),
        float(np.mean([abs(a.max() - b.max()) / b.max() for a, b in pairs])),
    )


def _run(
    way: str, data: Data, grid: Grid, steps: int, channels: int, rng: np.random.Generator
) -> tuple[list[Labels], float, dict[str, Any]]:
    """Train one representation: fragments of the held-out hits, the chosen knob, and the scores."""
    outputs = max(plate.labels.max() for plate in data.plates) if way.startswith("labels") else 1
    exact = np.stack([target(way, plate, outputs, rng) for plate in data.plates])
    predict = _trained(way, data.hits, exact, outputs, steps, channels, rng)
    remembered, images = predict(data.hits[:TUNED]), predict(data.held_hits)
    read = READERS[way]
    knobs = THRESHOLDS if way == "lines" else TOLERANCES if way == "USDF" else (0.0,)
    sought = data.plates[:TUNED]
    knob = min(knobs, key=lambda knob: score([read(image, knob, grid) for image in remembered], sought).bits)
    found = [read(image, knob, grid) for image in images]
    kept = exact[:TUNED, None] if outputs == 1 else np.stack([exact[:TUNED] == n for n in range(outputs)], axis=1)
    ceiling = [read(image, 0.5 if way == "lines" else knob, grid) for image in kept.astype(np.float32)]
    scores = {
        "ceiling": vars(score(ceiling, sought)),
        "training hits": vars(score([read(image, knob, grid) for image in remembered], sought)),
        "held out": vars(score(found, data.held)),
    }
    return found, knob, scores


def target(way: str, plate: Plate, outputs: int, rng: np.random.Generator) -> np.ndarray:
    """What the network is taught: channel numbers, or an image, shape (r, r)."""
    count = int(plate.labels.max())
    if way == "labels":
        return rng.permutation(outputs)[plate.labels - 1]
    if way == "labels by place":
        side = int(np.ceil(np.sqrt(outputs)))
        places = np.argwhere(np.ones((side, side)))[:outputs]
        middles = np.array(ndimage.center_of_mass(np.ones(plate.labels.shape), plate.labels, range(1, count + 1)))
        middles = middles / plate.labels.shape[0] * side - 0.5
        rows, columns = linear_sum_assignment(((middles[:, None] - places[None]) ** 2).sum(axis=-1))
        return columns[np.argsort(rows)][plate.labels - 1]
    return cracked(plate.labels).astype(np.float32) if way == "lines" else plate.distance


def _trained(
    way: str, hits: Floats, exact: np.ndarray, outputs: int, steps: int, channels: int, rng: np.random.Generator
) -> Callable[[Floats], np.ndarray]:
    """The decoder after `steps` steps: hits (n, 3) to images (n, outputs, r, r)."""
    import torch

    labels = way.startswith("labels")
    goal = torch.as_tensor(exact, dtype=torch.long if labels else torch.float32)
    scale = float(exact.std()) if way == "USDF" else 1.0
    with torch.random.fork_rng():
        torch.manual_seed(int(rng.integers(2**31)))
        network = _network(outputs, exact.shape[-1], channels)
    optimiser = torch.optim.Adam(network.parameters(), lr=2e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=4e-3, total_steps=steps)
    for _ in range(steps):
        chosen = rng.choice(len(hits), BATCH, replace=False)
        image = network(torch.as_tensor(hits[chosen], dtype=torch.float32))
        optimiser.zero_grad()
        _loss(way, image, goal[chosen], scale).backward()
        optimiser.step()
        schedule.step()

    def predict(hits: Floats) -> np.ndarray:
        with torch.no_grad():
            image = network(torch.as_tensor(hits, dtype=torch.float32))
        image = torch.softmax(image, 1) if labels else torch.sigmoid(image) if way == "lines" else image * scale
        return image.numpy()

    return predict


def _network(outputs: int, resolution: int, channels: int) -> Any:
    from torch import nn

    ups = int(np.log2(resolution // 8))
    layers: list[Any] = [nn.Linear(3, 128), nn.SiLU(), nn.Linear(128, 64 * 4 * channels)]
    layers += [nn.SiLU(), nn.Unflatten(1, (4 * channels, 8, 8))]
    wide = 4 * channels
    for n in range(ups):
        narrow = channels * (2 if n + 2 < ups else 1)
        layers += [nn.Upsample(scale_factor=2), nn.Conv2d(wide, narrow, 3, padding=1), nn.SiLU()]
        wide = narrow
    return nn.Sequential(*layers, nn.Conv2d(wide, outputs, 1))


def _loss(way: str, image: Any, goal: Any, scale: float) -> Any:
    from torch.nn import functional

    if way == "lines":
        return functional.binary_cross_entropy_with_logits(image[:, 0], goal)
    if way == "USDF":
        return functional.mse_loss(image[:, 0], goal / scale)
    share = image.softmax(dim=1)
    true = functional.one_hot(goal, image.shape[1]).permute(0, 3, 1, 2)
    overlap, total = (share * true).sum(dim=(2, 3)), (share + true).sum(dim=(2, 3))
    # Soft dice (Milletari et al. 2016); the 1 rewards channels that rightly stay empty.
    return 1 - ((2 * overlap + 1) / (total + 1)).mean()


def read_labels(image: np.ndarray, knob: float, grid: Grid) -> Labels:
    """The greatest channel's connected pieces."""
    best, pieces, count = image.argmax(axis=0), np.zeros(image.shape[1:], int), 0
    for name in np.unique(best):
        part, found = ndimage.label(best == name)
        pieces += np.where(part > 0, part + count, 0)
        count += found
    return join_small(pieces, SMALLEST)


def read_lines(image: np.ndarray, knob: float, grid: Grid) -> Labels:
    """Connected pieces between crack pixels."""
    return join_small(ndimage.label(image[0] < knob)[0], SMALLEST)


def read_distance(image: np.ndarray, knob: float, grid: Grid) -> Labels:
    """The flood of `segment` on one sheet of voxels."""
    values = np.full(grid.shape, -1, np.float32)
    middle = grid.resolution // 2
    values[:, :, middle] = image[0]
    flooded = segment(Volume(grid, values), tolerance=knob, min_voxels=SMALLEST)
    return join_small(flooded.labels[:, :, middle], 1)


READERS = {"labels": read_labels, "labels by place": read_labels, "lines": read_lines, "USDF": read_distance}


def _summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean and half-width of Student's 95 % interval over the seeds."""
    from scipy.stats import t

    out: dict[str, Any] = {}
    for way in runs[0]:
        for where in (key for key in runs[0][way] if key != "knob"):
            for name in ("bits", "count_error"):
                values = [run[way][where][name] for run in runs]
                half = t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))
                out.setdefault(way, {}).setdefault(where, {})[name] = [float(np.mean(values)), float(half)]
    return out


def _draw(path: Path, truth: list[Plate], hits: Floats, shown: dict[str, list[Labels]], summary: Any) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7.2), layout="constrained", dpi=100)
    left, right = figure.subfigures(1, 2, width_ratios=(1.7, 1))
    rows = {"truth": [plate.labels for plate in truth], **shown}
    axes = left.subplots(len(rows), COLUMNS)
    for row, (name, patterns) in zip(axes, rows.items(), strict=True):
        for axis, pattern, plate, hit in zip(row, patterns, truth, hits, strict=True):
            names = _like(pattern, plate.labels)
            picture = np.where(cracked(pattern), 0, 1 + names % 19)
            axis.imshow(picture.T, origin="lower", cmap="nipy_spectral", vmin=0, vmax=20, extent=(-1, 1, -1, 1))
            axis.plot(*hit[:2], "w+", markersize=5)
            axis.set(xticks=[], yticks=[], xlabel=f"{pattern.max()} fragments")
        row[0].set_ylabel(name)
    for axis, name, title in zip(
        right.subplots(2, 1), ("bits", "count_error"), ("variation of information [bits]", "fragment count error"),
        strict=True,
    ):  # fmt: skip
        bars = [(way, *summary[way]["held out"][name]) for way in (*WAYS, "nearest training hit", "same hit again")]
        names, means, halves = zip(*bars, strict=True)
        axis.barh(names, means, xerr=halves, color=["#bd5e3d"] * len(WAYS) + ["#b9c3ca"] * 2, capsize=3)
        axis.invert_yaxis()
        axis.set(xlim=(0, None))
        axis.set_title(f"{title}, held-out hits", fontsize=9)
    with atomic_file(path) as temporary:
        figure.savefig(temporary)


def _like(pattern: Labels, truth: Labels) -> Labels:
    """Names for colours: each fragment takes that of the true fragment it covers most."""
    return np.array([0, *(np.bincount(truth[pattern == n]).argmax() for n in range(1, pattern.max() + 1))])[pattern]


if __name__ == "__main__":
    import tyro

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    try:
        tyro.cli(flat_study)
    except BadInput as problem:
        sys.stderr.write(f"09_flat_study.py: {problem}\n")
        sys.exit(2)
