"""Laws of carving on random patterns: nothing is lost, and segmentation undoes encoding."""

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, generate_binary_structure, label, maximum_filter

from deepfracture.carve import cut, encode, segment, segment_as_published, voronoi_pattern
from deepfracture.types import FracturePattern, Fragments, Grid, Mesh, Shape, Volume
from deepfracture.validation.fragments import check_fragments

BOX = trimesh.creation.box((2, 1.2, 0.9))
SHAPE = Shape("box", Mesh(BOX.vertices, BOX.faces))


def box_distance(grid: Grid) -> np.ndarray:
    """Signed distance to the box, positive inside [m]."""
    past = np.abs(grid.centres()) - [1, 0.6, 0.45]
    outside = np.linalg.norm(np.maximum(past, 0), axis=-1)
    return (-outside - np.minimum(past.max(axis=-1), 0)).astype(np.float32)


def spread_sites(seed: int, count: int, apart: float) -> np.ndarray:
    """Up to `count` random points of the box at least `apart` from each other, (n, 3)."""
    sites: list[np.ndarray] = []
    for point in np.random.default_rng(seed).uniform([-1, -0.6, -0.45], [1, 0.6, 0.45], (400, 3)):
        if len(sites) < count and all(np.linalg.norm(point - site) > apart for site in sites):
            sites.append(point)
    return np.array(sites)


def assert_conserved(fragments: Fragments, grid: Grid) -> None:
    """Closed, whole, fitting and nowhere through themselves: see `validation.fragments`."""
    assert check_fragments(SHAPE, fragments, voxel=grid.spacing).failures == {}
    assert abs(fragments.volume / SHAPE.mesh.volume - 1) < 1e-6


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 12))
def test_segmentation_undoes_encoding(seed, count):
    """Same fragments, and all but the voxels beside the cracks in the right one."""
    grid = Grid(64)
    distance = box_distance(grid)
    pattern = voronoi_pattern(spread_sites(seed, count, 0.5), distance > 0, grid)
    found = segment(encode(pattern, distance))
    inside = pattern.labels > 0
    pairs, times = np.unique(np.stack([pattern.labels[inside], found.labels[inside]]), axis=1, return_counts=True)
    big = np.bincount(pattern.labels[inside]) >= 300  # smaller ones may hold no voxel off the boundary
    assert found.count <= pattern.count
    partner = {true: pairs[1][pairs[0] == true][np.argmax(times[pairs[0] == true])] for true in np.flatnonzero(big)}
    assert len(set(partner.values())) == big.sum()
    right = sum(t for (true, name), t in zip(pairs.T, times, strict=True) if partner.get(true) == name)
    assert right / big[pattern.labels[inside]].sum() > 0.95


def random_labels(rng: np.random.Generator, grid: Grid, count: int, blur: float, holes: float) -> np.ndarray:
    """Face-connected labels 1..n of the regions where one of `count` smoothed noises is the greatest, 0 in holes."""
    noise = rng.normal(size=(count, *grid.shape))
    kinds = np.argmax([gaussian_filter(n, blur) for n in noise], axis=0)
    kinds[rng.random(grid.shape) < holes] = -1
    labels = np.zeros(grid.shape, int)
    for kind in range(count):
        parts, _ = label(kinds == kind)
        labels = np.where(parts > 0, parts + labels.max(), labels)
    return labels


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 6),
    blur=st.sampled_from([0.0, 0.7, 2.0, 4.0]),
    holes=st.sampled_from([0.0, 0.01, 0.3, 0.9]),
    smallest=st.sampled_from([0, 1, 8, 50]),
)
def test_known_cuts_give_back_any_face_connected_labels(seed, count, blur, holes, smallest):
    """Whatever the distances say. Labels of too few voxels may join others; no two large ones do."""
    rng, grid = np.random.default_rng(seed), Grid(32)
    labels = random_labels(rng, grid, count, blur, holes)
    surface = np.where(labels > 0, rng.uniform(1e-6, 1, grid.shape), -rng.uniform(0, 1, grid.shape))
    pattern = FracturePattern(grid, labels, rng.uniform(0, 1, grid.shape) * (rng.random(grid.shape) < 0.5))
    found = segment(encode(pattern, surface), min_voxels=smallest).labels
    inside = labels > 0
    np.testing.assert_array_equal(found > 0, inside)
    pairs = np.unique(np.stack([labels[inside], found[inside]]), axis=1)
    assert len(np.unique(pairs[0])) == pairs.shape[1]  # none is parted
    large = pairs[1][np.bincount(labels.ravel())[pairs[0]] >= smallest]
    assert len(np.unique(large)) == len(large)
    np.testing.assert_array_equal(np.unique(found[inside]), np.arange(1, found.max() + 1))


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    blur=st.sampled_from([1.5, 2.0, 4.0]),
    tolerance=st.sampled_from([0.02, 0.04, 0.1]),
)
def test_the_published_flood_keeps_as_many_regions_as_there_are_lasting_maxima(seed, blur, tolerance):
    """Counted by lowering a level: a maximum lasts if its part of the set above stays apart for `tolerance`."""
    grid = Grid(32)
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=grid.shape), blur)
    values = (0.15 * noise / noise.std()).astype(np.float32)
    found = segment_as_published(Volume(grid, values), tolerance=tolerance)
    lasting = 0
    for height in np.sort(values[local_maxima(values)]):
        parts, _ = label(values > max(height - tolerance, -0.03))
        at = np.argwhere(local_maxima(values) & (values == height))[0]
        lasting += values[parts == parts[tuple(at)]].max() == height
    assert abs(found.count - lasting) <= 1  # depths within one level of sorting of the tolerance
    np.testing.assert_array_equal(found.labels > 0, values > 0)


def local_maxima(values: np.ndarray) -> np.ndarray:
    """Voxels above 0 that are the greatest of their six neighbours."""
    return (values > 0) & (values == maximum_filter(values, footprint=generate_binary_structure(3, 1)))


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 6),
    blur=st.sampled_from([0.0, 1.0, 3.0]),
    holes=st.sampled_from([0.0, 0.3, 0.99]),
)
def test_cut_conserves_volume_for_any_labels(seed, count, blur, holes):
    """White noise, blobs and scraps of labels: closed fragments that add up to the shape."""
    rng, grid = np.random.default_rng(seed), Grid(32)
    noise = rng.normal(size=(count, *grid.shape))
    labels = 1 + np.argmax([gaussian_filter(n, blur) for n in noise], axis=0)
    labels[rng.random(grid.shape) < holes] = 0
    distance = rng.uniform(0, grid.spacing, grid.shape)
    assert_conserved(cut(SHAPE, FracturePattern(grid, labels, distance), density=1000), grid)
