"""Crack distances, the GS-SDF and its segmentation against what is known exactly."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from deepfracture.carve import encode, segment, segment_as_published, voronoi_pattern
from deepfracture.geometry import distance_to_oriented_points
from deepfracture.types import BadInput, FracturePattern, Grid, Volume

GRID = Grid(64)
BALL = (0.9 - np.linalg.norm(GRID.centres(), axis=-1)).astype(np.float32)


def on_sphere(n: int) -> np.ndarray:
    """Fibonacci points on the unit sphere, (n, 3)."""
    i = np.arange(n) + 0.5
    z, turn = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)


def variation_of_information(a: np.ndarray, b: np.ndarray) -> float:
    """Distance between two partitions [bits] (Meila 2003), over voxels labelled in both."""
    both = (a > 0) & (b > 0)
    _, joint = np.unique(np.stack([a[both], b[both]]), axis=1, return_counts=True)
    entropy = [-(n / n.sum() * np.log2(n / n.sum())).sum() for n in (joint,)]
    for part in (a[both], b[both]):
        p = np.unique(part, return_counts=True)[1] / both.sum()
        entropy.append(-(p * np.log2(p)).sum())
    return float(2 * entropy[0] - entropy[1] - entropy[2])


def test_distance_to_a_sphere_of_points():
    points = 0.6 * on_sphere(12000)
    found = distance_to_oriented_points(GRID, points, points / 0.6)
    error = np.abs(found - np.abs(np.linalg.norm(GRID.centres(), axis=-1) - 0.6)) / GRID.spacing
    assert error.mean() < 0.03 and error.max() < 0.25


def test_every_voxel_finds_the_nearest_of_many_points():
    grid = Grid(32)
    points = np.random.default_rng(0).uniform(-1, 1, (40, 3))  # so sparse that the plane of a point says nothing
    normals = np.tile([0.0, 0.0, 1.0], (40, 1))
    found = distance_to_oriented_points(grid, points, normals)
    away = grid.centres()[..., None, :] - points
    nearest = np.take_along_axis(away, (away**2).sum(-1).argmin(-1)[..., None, None], axis=-2)[..., 0, :]
    spacing, _ = KDTree(points).query(points, k=2)
    across = np.maximum(np.linalg.norm(nearest[..., :2], axis=-1) - 2 * np.median(spacing[:, 1]), 0)
    exact = np.hypot(nearest[..., 2], across)
    assert np.isclose(found, exact, atol=1e-5).mean() > 0.999  # two rounds of propagation miss next to nothing


def test_distance_past_the_rim_of_a_crack_is_to_the_rim():
    side = np.linspace(-0.3, 0.3, 80)
    x, y = np.meshgrid(side, side)
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.1)], axis=-1)
    found = distance_to_oriented_points(GRID, points, np.tile([0.0, 0.0, -1.0], (len(points), 1)))
    past = np.maximum(np.abs(GRID.centres()) - [0.3, 0.3, 9], 0)
    past[..., 2] = GRID.centres()[..., 2] - 0.1
    error = np.abs(found - np.linalg.norm(past, axis=-1)) / GRID.spacing
    assert error.max() < 0.6 and error.mean() < 0.4
    assert error[np.linalg.norm(past[..., :2], axis=-1) == 0].max() < 1e-4


def test_distance_without_cracks_is_far_and_bad_points_are_refused():
    assert (distance_to_oriented_points(GRID, np.zeros((0, 3)), np.zeros((0, 3))) > 3.4).all()
    with pytest.raises(BadInput, match=r"\(n, 3\)"):
        distance_to_oriented_points(GRID, np.zeros((2, 3)), np.zeros((1, 3)))
    with pytest.raises(BadInput, match="finite"):
        distance_to_oriented_points(GRID, np.full((1, 3), np.nan), np.ones((1, 3)))


def test_two_cells_have_the_exact_distance_to_their_wall():
    pattern = voronoi_pattern([[-0.4, 0, 0], [0.2, 0.3, 0]], BALL > 0, GRID)
    normal = np.array([0.6, 0.3, 0]) / np.hypot(0.6, 0.3)
    wall = np.abs((GRID.centres() - [-0.1, 0.15, 0]) @ normal)
    inside = BALL > 0
    assert pattern.count == 2
    np.testing.assert_allclose(pattern.distance[inside], wall[inside], atol=1e-6)
    assert (pattern.labels[~inside] == 0).all()


def test_encode_takes_the_nearest_boundary_inside_and_the_surface_outside():
    pattern = voronoi_pattern([[-0.4, 0, 0], [0.4, 0, 0]], BALL > 0, GRID)
    values = encode(pattern, BALL).values
    exact = np.where(BALL > 0, np.minimum(BALL, np.abs(GRID.centres()[..., 0])), BALL)
    np.testing.assert_allclose(values, exact, atol=1e-6)
    with pytest.raises(BadInput, match="shape"):
        encode(pattern, BALL[:-1])


def test_encode_uses_the_surface_alone_where_no_label_is_known():
    empty = FracturePattern(GRID, np.zeros(GRID.shape), np.zeros(GRID.shape))
    np.testing.assert_array_equal(encode(empty, BALL).values, BALL)


def test_segment_keeps_a_necked_fragment_whole():
    """Two balls joined by a wide neck are one fragment; joined by a thread of a voxel, two."""
    x, y, z = np.moveaxis(GRID.centres(), -1, 0)
    balls = np.maximum(*(0.45 - np.sqrt((x - c) ** 2 + y**2 + z**2) for c in (-0.5, 0.5)))
    counts = [
        segment(Volume(GRID, np.maximum(balls, np.where(np.abs(x) < 0.5, neck - np.hypot(y, z), -1)))).count
        for neck in (0.38, 0.04)
    ]
    assert counts == [1, 2]


def test_segment_cracks_of_a_blurred_field():
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(3)
    pattern = voronoi_pattern(0.55 * on_sphere(7) + 0.02 * rng.normal(size=(7, 3)), BALL > 0, GRID)
    blurred = gaussian_filter(encode(pattern, BALL).values, 1.0)
    found = segment(Volume(GRID, blurred))
    assert found.count == 7
    assert variation_of_information(pattern.labels, found.labels) < 0.5


def test_segment_leads_splinters_home_through_the_cage():
    """A speck of few voxels beside a ball, a gap of one voxel between: one fragment, none lost."""
    values = BALL * 0.5 - 0.2
    i, j, k = np.argwhere(values > 0).max(axis=0)[0] + 2, 31, 31
    values[i, j, k] = 0.01
    values[i - 1, j, k] = -0.01
    found = segment(Volume(GRID, values))
    assert found.count == 1 and found.labels[i, j, k] == 1 and found.labels[i - 1, j, k] == 0


@pytest.mark.parametrize("values", [np.full(GRID.shape, -1.0), np.full(GRID.shape, -0.001)])
def test_segment_of_nothing_is_nothing(values):
    assert segment(Volume(GRID, values)).count == 0


def test_segment_of_one_plateau_is_one_fragment():
    assert segment(Volume(GRID, np.full(GRID.shape, 0.5))).count == 1


def test_segment_refuses_impossible_options():
    with pytest.raises(BadInput, match="tolerance"):
        segment(Volume(GRID, BALL), tolerance=1.0)
    with pytest.raises(BadInput, match="min_voxels"):
        segment(Volume(GRID, BALL), min_voxels=-1)


def test_what_is_encoded_with_cuts_comes_back_exactly():
    """Slabs a voxel thick, a label in two parts, random labels: all that the flood cannot know."""
    rng = np.random.default_rng(0)
    inside = BALL > 0
    i, j, k = np.indices(GRID.shape)
    slabs = np.where(inside, i + 1, 0)
    checks = np.where(inside, 1 + (i // 6) + 11 * (j // 6) + 121 * (k // 6), 0)
    for labels in (slabs, checks):
        pattern = FracturePattern(GRID, labels, rng.uniform(0, 0.1, GRID.shape))
        found = segment(encode(pattern, BALL), min_voxels=1)
        pairs = np.unique(np.stack([labels[inside], found.labels[inside]]), axis=1)
        assert found.count == len(np.unique(labels[inside])) == pairs.shape[1]
        assert (found.labels[~inside] == 0).all()


def test_parts_of_one_label_that_a_crack_parts_are_two_fragments():
    labels = np.where(BALL > 0, 1 + (np.abs(GRID.centres()[..., 0]) < 0.2), 0)
    assert segment(encode(FracturePattern(GRID, labels, np.ones(GRID.shape)), BALL)).count == 3


def test_dust_between_cuts_joins_what_it_touches_most():
    labels = np.where(BALL > 0, 1 + (GRID.centres()[..., 0] > 0), 0)
    labels[20:21, 30:32, 30:32] = 3
    labels[24, 24, 24] = 4
    labels[25, 25, 25] = 5  # two specks that touch at a corner
    found = segment(encode(FracturePattern(GRID, labels, np.ones(GRID.shape)), BALL), min_voxels=8)
    assert found.count == 2
    assert len(np.unique(found.labels[:32][BALL[:32] > 0])) == 1


def test_regions_are_numbered_in_the_order_of_their_first_voxels():
    labels = np.where(BALL > 0, 3 - (GRID.centres()[..., 0] > 0), 0)
    found = segment(encode(FracturePattern(GRID, labels, np.ones(GRID.shape)), BALL)).labels
    assert found[found > 0][0] == 1 and found.max() == 2


def test_voxels_of_a_wall_thinner_than_a_voxel_hang_together_at_their_edges():
    labels = np.zeros(GRID.shape, np.int32)
    diagonal = np.arange(10, 40)
    labels[diagonal, diagonal, 30] = 1
    surface = np.where(labels > 0, 0.01, -0.01)
    assert segment(encode(FracturePattern(GRID, labels, np.ones(GRID.shape)), surface)).count == 1


def lobes(depth: float) -> Volume:
    """Two balls, their peaks `depth` [m] above the pass between them."""
    x, y, z = np.moveaxis(GRID.centres(), -1, 0)
    away = np.sqrt((np.abs(x) - depth) ** 2 + y**2 + z**2)
    return Volume(GRID, (0.4 - away).astype(np.float32))


@pytest.mark.parametrize(
    ("depth", "tolerance", "count"), [(0.3, 0.04, 2), (0.3, 0.35, 1), (0.1, 0.04, 2), (0.1, 0.2, 1)]
)
def test_the_published_depth_is_in_metres(depth, tolerance, count):
    found = segment_as_published(lobes(depth), tolerance=tolerance)
    assert found.count == count
    np.testing.assert_array_equal(found.labels > 0, lobes(depth).values > 0)


def test_the_published_flood_takes_no_notice_of_cuts_and_leads_through_the_cage():
    cuts = np.zeros(GRID.shape, np.uint8)
    cuts[31] = 1
    whole = Volume(GRID, BALL, cuts)
    assert segment(whole).count == 2
    assert segment_as_published(whole).count == 1
    values = np.full(GRID.shape, -1.0)
    values[20:44, 20:44, 20:44] = 0.01
    values[32] = -0.02
    assert segment_as_published(Volume(GRID, values)).count == 1
    values[32] = -0.04
    assert segment_as_published(Volume(GRID, values)).count == 2


def test_the_published_flood_finds_the_regions_of_minima_and_watershed():
    pytest.importorskip("skimage", reason="scikit-image is not installed")
    from scipy.ndimage import gaussian_filter

    from deepfracture.bench.reference import reference_labels

    rng = np.random.default_rng(5)
    pattern = voronoi_pattern(rng.uniform(-0.5, 0.5, (14, 3)), BALL > 0, GRID)
    volume = Volume(GRID, gaussian_filter(encode(pattern, BALL).values, 0.7))
    ours, theirs = segment_as_published(volume).labels, reference_labels(volume)
    inside = (volume.values > 0) & (theirs > 0)
    assert ours.max() == len(np.unique(theirs[inside])) > 5
    assert variation_of_information(ours[inside], theirs[inside]) < 0.05


def test_the_published_flood_refuses_impossible_depths():
    for wrong in (-0.01, np.nan, np.inf):
        with pytest.raises(BadInput, match="tolerance"):
            segment_as_published(Volume(GRID, BALL), tolerance=wrong)


def test_values_too_large_to_be_distances_are_as_good_as_far():
    far = np.where(BALL > 0, np.float32(3e38), BALL)
    assert segment(Volume(GRID, far)).count == segment_as_published(Volume(GRID, far)).count == 1
