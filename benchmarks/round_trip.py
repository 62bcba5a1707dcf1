"""Table of docs/explanation/cutting.md: loss of a fracture pattern encoded as a GS-SDF and segmented in three ways.

    python benchmarks/round_trip.py data/pot data/squirrel --out runs/round_trip

The paper's flood (absolute depth) and ours (depth relative to the peak) see the distances alone; the third also knows
which faces between voxels are cut. Patterns: those of data sets, at their own resolution; the squirrel that FractureRB
broke, of which only the labels at r = 128 are known; and a squirrel that our own simulator has crushed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from harness import DATA, REFERENCE, ROOT, shape_named, start, table, throw, write_text
from scipy.ndimage import distance_transform_edt, find_objects, gaussian_filter

from deepfracture.carve import encode, segment, segment_as_published
from deepfracture.compare import variation_of_information
from deepfracture.dataset import Dataset, open_dataset
from deepfracture.fracture import material, prepare_body, simulate
from deepfracture.geometry import distance_to_oriented_points, signed_distance
from deepfracture.runtime.progress import log, track
from deepfracture.types import BadInput, Floats, Floats32, FracturePattern, Grid, Labels, Shape, Volume

SQUIRREL = "squirrel_fracturerb_26.npz"
SMOOTHING = 1.0
"""Width [voxels] of the Gaussian that turns voxel stairs into crack surfaces."""
WAYS: dict[str, Callable[[Volume], FracturePattern]] = {
    "the paper's flood": segment_as_published,
    "our flood": lambda volume: segment(Volume(volume.grid, volume.values)),
    "with cuts": segment,
}


@dataclass(frozen=True)
class Trip:
    """One pattern there and back."""

    fragments: int
    found: int
    bits: float
    """Variation of information."""


def round_trip(
    datasets: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")],
    /,
    patterns: int = 10,
    speed: float = 200.0,
    data: Path = DATA,
    reference: Path = REFERENCE,
    out: Path = ROOT / "runs" / "round_trip",
) -> Path:
    """Send patterns through the field and back; writes round_trip.md.

    Args:
        datasets: folders made by deepfracture simulate.
        patterns: how many of each, evenly chosen.
        speed: of the ball that crushes the squirrel [m/s].
        data: folder with squirrel.obj.
        reference: folder with the labels that FractureRB left.
        out: folder for the result.
    """
    if not datasets or patterns < 1:
        raise BadInput("datasets: none given, or no patterns of them; make some with deepfracture simulate")
    opened = [open_dataset(path) for path in datasets]
    rows = [row for dataset in track(opened, name="data sets") for row in of_dataset(dataset, patterns)]
    for broken in broken_squirrels(data, reference, speed):
        rows += of_labels(*broken)
    head = ("pattern", "r", "way", "fragments", "found", "bits, mean", "bits, worst")
    write_text(out / "round_trip.md", f"# Round trip\n\n{table(head, rows)}")
    return out / "round_trip.md"


def trips(pattern: FracturePattern, surface: Floats32) -> dict[str, Trip]:
    """The pattern through `encode` and back, each way; over the voxels that it labels inside the surface."""
    volume = encode(pattern, surface)
    mask = (pattern.labels > 0) & (surface > 0)
    count = len(np.unique(pattern.labels[mask]))
    found = {name: way(volume) for name, way in WAYS.items()}
    return {
        name: Trip(count, back.count, variation_of_information(pattern.labels, back.labels, mask))
        for name, back in found.items()
    }


def of_dataset(dataset: Dataset, patterns: int) -> list[list[str]]:
    """Rows of `patterns` samples of a data set."""
    resolution = dataset.settings.resolution
    surface = signed_distance(dataset.shape.mesh, Grid(resolution))
    chosen = np.unique(np.linspace(0, len(dataset) - 1, min(patterns, len(dataset))).astype(int))
    made = [trips(dataset[int(k)].pattern, surface) for k in chosen]
    return report(f"{dataset.shape.name}, {len(chosen)} simulated", resolution, made)


def of_labels(name: str, shape: Shape, labels: Labels) -> Iterator[list[str]]:
    """Rows of labels at r = 128 whose cracks lie on their smoothed boundaries, at r = 128 and 64."""
    fine = Grid(labels.shape[0])
    points, normals = cracks_of(labels, fine)
    for grid, own in ((fine, labels), (Grid(64), halved(labels))):
        surface = signed_distance(shape.mesh, grid)
        distance = distance_to_oriented_points(grid, points, normals)
        pattern = FracturePattern(grid, np.where(surface > 0, own, 0), distance)
        yield from report(name, grid.resolution, [trips(pattern, surface)])


def report(name: str, resolution: int, made: Sequence[dict[str, Trip]]) -> list[list[str]]:
    """A row for each way."""
    rows = []
    for way in WAYS:
        of = [trip[way] for trip in made]
        bits = [trip.bits for trip in of]
        rows.append([
            name, str(resolution), way, f"{np.mean([trip.fragments for trip in of]):.4g}",
            f"{np.mean([trip.found for trip in of]):.4g}", f"{np.mean(bits):.3f}", f"{np.max(bits):.3f}",
        ])  # fmt: skip
    return rows


def broken_squirrels(data: Path, reference: Path, speed: float) -> Iterator[tuple[str, Shape, Labels]]:
    """Labels at r = 128 of the squirrel that FractureRB broke, and of one that a ball of `speed` [m/s] crushed."""
    shape, file = shape_named("squirrel", data), reference / SQUIRREL
    if shape is None:
        return
    if file.is_file():
        with np.load(file, allow_pickle=False) as kept:
            labels = kept["labels"].astype(np.int32)
        yield "squirrel, FractureRB", shape, filled(labels)
    else:
        log.warning("%s: skipped: not in %s", SQUIRREL, reference)
    plaster = material("plaster")
    hit = throw(shape, plaster, 1, seed=0, speed=(speed, speed + 1))
    cracked = simulate(prepare_body(shape, plaster, Grid(128)), hit.impact, hit.rng)
    if cracked is None:
        raise BadInput(f"speed {speed:g} m/s: the squirrel does not break; give a faster ball")
    yield "squirrel, crushed", shape, filled(cracked.pattern.labels)


def filled(labels: Labels) -> Labels:
    """Every voxel without a label takes that of the nearest one: labels may end short of the surface."""
    nearest = distance_transform_edt(labels == 0, return_distances=False, return_indices=True)
    return labels[tuple(nearest)]  # type: ignore[arg-type]


def halved(labels: Labels) -> Labels:
    """The most frequent label, the smallest of equals, of each block of 2 x 2 x 2 voxels."""
    n = labels.shape[0] // 2
    blocks = np.moveaxis(labels.reshape(n, 2, n, 2, n, 2), (1, 3, 5), (3, 4, 5)).reshape(n, n, n, 8)
    blocks = np.sort(blocks, axis=-1)
    votes = (blocks[..., None] == blocks[..., None, :]).sum(axis=-1)
    return np.take_along_axis(blocks, votes.argmax(axis=-1)[..., None], axis=-1)[..., 0]


def cracks_of(labels: Labels, grid: Grid) -> tuple[Floats, Floats]:
    """Where cracks between labels cross the edges of the grid [m], and their normals, shapes (n, 3).

    Each label's indicator is smoothed; between a and b the crack lies where the two are equal."""
    ends = [_parted(labels, axis) for axis in range(3)]
    near, far = (np.concatenate([pair[side] for pair in ends]) for side in (0, 1))
    a, b = labels[tuple(near.T)], labels[tuple(far.T)]
    lead = np.zeros((2, 4, len(near)))  # smoothed a - b and its gradient, at both ends
    reach = int(np.ceil(4 * SMOOTHING)) + 2
    for name, box in enumerate(find_objects(labels), 1):
        if box is None:
            continue
        corner = np.array([side.start for side in box]) - reach
        soft = gaussian_filter(np.pad(labels[box] == name, reach).astype(np.float32), SMOOTHING)
        fields = np.stack([soft, *np.gradient(soft)])
        for own, sign in ((a == name, 1), (b == name, -1)):
            for end, at in enumerate((near, far)):
                lead[end][:, own] += sign * fields[(slice(None), *(at[own] - corner).T)]
    ahead, behind = np.maximum(lead[0, 0], 1e-6), np.maximum(-lead[1, 0], 1e-6)
    points = near + (far - near) * (ahead / (ahead + behind))[:, None]
    normals = (lead[0, 1:] + lead[1, 1:]).T
    return grid.to_world(points), normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-9)[:, None]


def _parted(labels: Labels, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Voxels and the next ones along an axis that have another label, shapes (n, 3)."""
    ahead, beyond = (np.moveaxis(labels, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
    near = np.argwhere(np.moveaxis((ahead != beyond) & (ahead > 0) & (beyond > 0), 0, axis))
    return near, near + np.eye(3, dtype=int)[axis]


if __name__ == "__main__":
    start(round_trip)
