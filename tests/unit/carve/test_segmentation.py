"""The shortcuts of segmentation against the plain rules that they stand for, voxel by voxel."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from deepfracture.carve import segment
from deepfracture.carve.segmentation.segment import BAND
from deepfracture.carve.segmentation.watershed import BUCKETS
from deepfracture.types import Grid, Volume
from deepfracture.voxels import components_of_at_least, cut_faces

GRID = Grid(32)
STEPS = sorted(
    (step for step in product((-1, 0, 1), repeat=3) if any(step)),
    key=lambda step: np.linalg.norm(step),
)
FACES = 6


def plain_flood(volume: Volume, tolerance: float, min_voxels: int) -> np.ndarray:
    """`segment` without cuts as its documentation says it: every voxel in turn, from the highest down."""
    heights = np.pad(volume.values / np.float32(volume.grid.spacing), 1, constant_values=-np.inf)
    lowest = -BAND / volume.grid.spacing
    members = np.flatnonzero(heights.ravel() > lowest)
    shape, flat = heights.shape, heights.ravel()
    top = float(flat.max())
    level = ((top - flat[members].astype(float)) * ((BUCKETS - 1) / (top - lowest))).astype(int)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    steps = [(int(np.dot(step, strides)), np.float32(np.linalg.norm(step))) for step in STEPS]
    label, parent, peak, size = {}, [0], [0.0], [0]

    def root(region: int) -> int:
        while parent[region] != region:
            region = parent[region]
        return region

    order = members[np.argsort(level, kind="stable")]
    for v in order.tolist():
        best, steepest = 0, -np.inf
        for step, length in steps:
            if label.get(v + step, 0):
                slope = float((flat[v + step] - flat[v]) / length) + 10.0 * (flat[v + step] + flat[v] > length)
                if slope > steepest:
                    best, steepest = label[v + step], slope
        if best == 0:
            if flat[v] <= 0:
                continue
            best = len(parent)
            parent.append(best)
            peak.append(float(flat[v]))
            size.append(0)
        region = label[v] = root(best)
        size[region] += int(flat[v] > 0)
        for step, _ in steps[:FACES]:
            other = root(label.get(v + step, 0))
            if other in (0, region):
                continue
            low, high = (region, other) if peak[region] < peak[other] else (other, region)
            crest = 0.5 * float(flat[v + step] + flat[v])
            if peak[low] - crest < tolerance * peak[low] or size[low] < min_voxels:
                parent[low] = high
                size[high] += size[low]
                region = high
    names, found = {}, np.zeros(flat.size, np.int32)
    for v in order.tolist():
        if flat[v] > 0:
            found[v] = names.setdefault(root(label[v]), len(names) + 1)
    return found.reshape(shape)[1:-1, 1:-1, 1:-1]


def in_a_block(field: np.ndarray) -> Volume:
    """A field of shape (16, 16, 16) somewhere in the grid, far outside all around."""
    values = np.full(GRID.shape, -1.0, np.float32)
    values[3:19, 9:25, 16:32] = field
    return Volume(GRID, values)


def noise(seed: int, smooth: float, height: float, offset: float) -> np.ndarray:
    field = gaussian_filter(np.random.default_rng(seed).normal(size=(16, 16, 16)), smooth)
    return field / field.std() * height + offset


HOSTILE = {
    "smooth": noise(0, 2, 0.1, 0.05),
    "rough": noise(1, 0.5, 0.05, 0.0),
    "raw noise": noise(2, 0, 0.3, 0.0),
    "in the cage": noise(3, 1, 0.02, -0.02),
    "steps": np.round(noise(4, 1, 0.1, 0.05), 1),
    "all in": np.ones((16, 16, 16)),
    "all out": -np.ones((16, 16, 16)),
    "one voxel": np.pad(np.full((1, 1, 1), 0.3), ((7, 8), (3, 12), (0, 15)), constant_values=-0.01),
    "checkerboard": np.where(np.indices((16, 16, 16)).sum(axis=0) % 2, 0.1, -0.02),
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize(("tolerance", "min_voxels"), [(0.5, 8), (0.0, 0), (0.9, 1), (0.2, 60)])
def test_basins_first_gives_what_the_plain_flood_gives(name: str, tolerance: float, min_voxels: int) -> None:
    volume = in_a_block(HOSTILE[name])
    found = segment(volume, tolerance=tolerance, min_voxels=min_voxels)
    assert (found.labels == plain_flood(volume, tolerance, min_voxels)).all()


def test_a_flood_that_merges_nothing_differs_from_one_that_does() -> None:
    volume = in_a_block(HOSTILE["smooth"])
    assert segment(volume, tolerance=0.0, min_voxels=0).count > segment(volume).count


def plain_join(inside: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """Regions by spreading from each voxel in turn."""
    labels, count = np.zeros(inside.shape, np.int32), 0
    for start in zip(*np.nonzero(inside), strict=True):
        if labels[start]:
            continue
        count += 1
        labels[start] = count
        edge = [start]
        while edge:
            here = edge.pop()
            for axis, ahead in product(range(3), (0, 1)):
                there = tuple(x + (2 * ahead - 1) * (n == axis) for n, x in enumerate(here))
                if not 0 <= there[axis] < inside.shape[axis] or not inside[there] or labels[there]:
                    continue
                if not cuts[here if ahead else there] >> axis & 1:
                    labels[there] = count
                    edge.append(there)
    return labels


@pytest.mark.parametrize(("filled", "cut"), [(0.9, 0.3), (0.5, 0.0), (0.3, 0.5), (1.0, 0.8), (1.0, 1.0), (0.0, 0.0)])
def test_spans_give_the_regions_that_spreading_gives(filled: float, cut: float) -> None:
    rng = np.random.default_rng(int(100 * filled))
    values = np.where(rng.random((20, 20, 20)) < filled, 0.1, -0.1).astype(np.float32)
    cuts = ((rng.random((3, 20, 20, 20)) < cut) << np.arange(3)[:, None, None, None]).sum(axis=0).astype(np.uint8)
    labels = components_of_at_least(values, cuts, 0)
    assert labels.dtype == np.int32
    assert (labels == plain_join(values > 0, cuts)).all()


def test_small_regions_go_where_they_touch_most() -> None:
    values = np.full((12, 12, 12), -1.0, np.float32)
    values[2:6, 2:6, 2:6] = values[6:10, 2:6, 2:6] = values[5:7, 6, 4] = 1.0
    cuts = np.zeros(values.shape, np.uint8)
    cuts[5, 2:7, 2:6] |= 1  # between the two halves, and through the crumb of two voxels on their side
    cuts[5:7, 5, 4] |= 2
    assert components_of_at_least(values, cuts, 0).max() == 4
    labels = components_of_at_least(values, cuts, 5)
    assert labels.max() == 2
    assert labels[5, 6, 4] == labels[5, 5, 4] == 1 and labels[6, 6, 4] == labels[6, 5, 4] == 2


@pytest.mark.parametrize("dtype", [np.int32, np.int16])
def test_cuts_stand_where_two_labels_meet(dtype: type) -> None:
    labels = np.random.default_rng(0).integers(0, 4, (9, 9, 9)).astype(dtype)
    cuts = cut_faces(labels[:, ::-1])
    for axis in range(3):
        there = np.roll(labels[:, ::-1], -1, axis)
        np.moveaxis(there, axis, 0)[-1] = 0
        parted = (labels[:, ::-1] != there) & (labels[:, ::-1] > 0) & (there > 0)
        assert ((cuts >> axis & 1) == parted).all()
    assert cuts.max() < 8
