"""Cutting: closed fragments that fill the original, keep its surface and fit each other."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from deepfracture.carve import cut, voronoi_pattern
from deepfracture.geometry import builtin, load_shape, signed_distance
from deepfracture.types import BadInput, FracturePattern, Fragments, Grid, Mesh, Shape

GRID = Grid(64)
DATA = Path(__file__).parents[4] / "shared" / "data"


def ball() -> Shape:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    return Shape("ball", Mesh(sphere.vertices, sphere.faces))


def slab(thickness: float) -> Shape:
    box = trimesh.creation.box((2, 1, thickness))
    return Shape("slab", Mesh(box.vertices, box.faces))


def cells(shape: Shape, sites: int, seed: int = 0, grid: Grid = GRID) -> FracturePattern:
    distance = signed_distance(shape.mesh, grid)
    inside = grid.to_world(np.argwhere(distance > 0))
    return voronoi_pattern(np.random.default_rng(seed).permutation(inside)[:sites], distance > 0, grid)


def assert_closed(mesh: Mesh) -> None:
    """Every edge belongs to two faces that run along it in opposite directions; one component."""
    ends = np.concatenate([mesh.faces[:, [a, (a + 1) % 3]] for a in range(3)])
    forth, back = (np.unique(e, axis=0, return_counts=True) for e in (ends, ends[:, ::-1]))
    assert (forth[1] == 1).all()
    np.testing.assert_array_equal(forth[0], back[0])
    assert len(trimesh.graph.connected_components(ends, min_len=1, nodes=np.arange(len(mesh.vertices)))) == 1
    assert mesh.volume > 0


def assert_fills(fragments: Fragments, shape: Shape) -> None:
    for piece in fragments:
        assert_closed(piece.mesh)
    assert fragments.volume == pytest.approx(shape.mesh.volume, rel=1e-6)


def assert_outside_is_original(fragments: Fragments, shape: Shape) -> None:
    """Outside triangles lie in their source, together they cover it, whole ones are unchanged."""
    covered = np.zeros(len(shape.mesh.faces))
    for piece in fragments:
        own = piece.source >= 0
        triangles, source = piece.mesh.triangles[own], piece.source[own]
        corners, normals = shape.mesh.triangles[source], shape.mesh.area_vectors[source]
        unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        np.add.at(covered, source, np.einsum("ni,ni->n", piece.mesh.area_vectors[own], unit))
        for a in range(3):  # no corner beyond any side of the source, or off its plane
            inward = np.cross(normals, corners[:, (a + 1) % 3] - corners[:, a])
            inward /= np.linalg.norm(inward, axis=1, keepdims=True)
            offset = triangles - corners[:, [a]]
            assert np.einsum("nci,ni->nc", offset, inward).min() > -1e-9
            assert np.abs(np.einsum("nci,ni->nc", offset, unit)).max() < 1e-9
    np.testing.assert_allclose(covered, np.linalg.norm(shape.mesh.area_vectors, axis=1), rtol=1e-6, atol=1e-12)
    points = {tuple(p) for piece in fragments for p in piece.mesh.vertices}
    assert all(tuple(p) in points for p in shape.mesh.vertices[np.unique(shape.mesh.faces)])


def assert_neighbours_fit(fragments: Fragments) -> None:
    """Inner faces cancel, and each of their corners belongs to two fragments or more."""
    inner = np.concatenate([piece.mesh.triangles[piece.source < 0] for piece in fragments])
    area = np.concatenate([piece.mesh.area_vectors[piece.source < 0] for piece in fragments])
    assert np.abs(area.sum(axis=0)).max() < 1e-9
    corners = {tuple(p) for p in np.round(inner.reshape(-1, 3), 9)}
    times = dict.fromkeys(corners, 0)
    for piece in fragments:
        own = np.unique(np.round(piece.mesh.triangles[piece.source < 0].reshape(-1, 3), 9), axis=0)
        for p in own:
            times[tuple(p)] += 1
    assert min(times.values()) >= 2


@pytest.mark.parametrize("make", [ball, lambda: slab(0.3), lambda: builtin("pot"), lambda: builtin("chair")])
def test_fragments_fill_the_shape_keep_its_surface_and_fit(make):
    shape = make()
    fragments = cut(shape, cells(shape, 8), density=1000)
    assert len(fragments) >= 8
    assert_fills(fragments, shape)
    assert_outside_is_original(fragments, shape)
    assert_neighbours_fit(fragments)


def test_squirrel():
    if not (DATA / "squirrel.obj").exists():
        pytest.skip("../shared/data/squirrel.obj is not here")
    shape = load_shape(str(DATA / "squirrel.obj"))
    fragments = cut(shape, cells(shape, 20), density=1000)
    assert_fills(fragments, shape)
    assert_outside_is_original(fragments, shape)
    assert_neighbours_fit(fragments)


def test_planar_crack_is_flat_to_a_twentieth_of_a_voxel():
    shape = ball()
    normal = np.array([2.0, 1.0, 0.5]) / np.linalg.norm([2.0, 1.0, 0.5])
    distance = signed_distance(shape.mesh, GRID)
    pieces = cut(shape, voronoi_pattern([-0.3 * normal, 0.3 * normal], distance > 0, GRID), density=1).pieces
    assert len(pieces) == 2
    for piece in pieces:
        off = piece.mesh.vertices[np.unique(piece.mesh.faces[piece.source < 0])] @ normal / GRID.spacing
        assert np.abs(off).mean() < 0.05 and np.abs(off).max() < 0.5


def test_roughness_scatters_crack_faces_and_nothing_else():
    shape = slab(0.5)
    pattern = cells(shape, 6)
    plain, rough = (cut(shape, pattern, density=1, roughness=grain) for grain in (0, 0.3 * GRID.spacing))
    assert len(plain) == len(rough)
    assert_fills(rough, shape)
    assert_outside_is_original(rough, shape)
    assert_neighbours_fit(rough)
    spread = [np.concatenate([p.mesh.area_vectors[p.source < 0] for p in pieces]) for pieces in (plain, rough)]
    area = [np.linalg.norm(vectors, axis=1).sum() for vectors in spread]
    assert 1.02 * area[0] < area[1] < 1.5 * area[0]
    with pytest.raises(BadInput, match="roughness"):
        cut(shape, pattern, density=1, roughness=-1)


def test_mass_centre_and_inertia_are_those_of_the_pieces():
    shape = slab(0.5)
    distance = signed_distance(shape.mesh, GRID)
    left, right = sorted(
        cut(shape, voronoi_pattern([[-0.5, 0, 0], [0.5, 0, 0]], distance > 0, GRID), density=2000),
        key=lambda piece: piece.centre[0],
    )
    for piece, side in ((left, -1), (right, 1)):
        assert piece.mass == pytest.approx(2000 * 0.5, rel=1e-3)
        np.testing.assert_allclose(piece.centre, [0.5 * side, 0, 0], atol=2e-3)
        exact = piece.mass / 12 * np.array([1 + 0.25, 1 + 0.25, 2])
        np.testing.assert_allclose(np.diag(piece.inertia), exact, rtol=5e-3)


def test_one_label_returns_the_original():
    shape = ball()
    (piece,) = cut(shape, cells(shape, 1), density=1000)
    assert piece.mesh is shape.mesh
    np.testing.assert_array_equal(piece.source, np.arange(len(shape.mesh.faces)))


def test_no_label_returns_the_original():
    shape = ball()
    empty = FracturePattern(GRID, np.zeros(GRID.shape), np.zeros(GRID.shape))
    assert len(cut(shape, empty, density=1000)) == 1


def test_shape_thinner_than_a_voxel_is_cut_without_loss():
    shape = slab(0.01)  # a third of a voxel, between two layers of voxel centres
    labels = np.zeros(GRID.shape, np.int32)
    labels[:32, :, 30:32], labels[32:, :, 30:32] = 1, 2
    fragments = cut(shape, FracturePattern(GRID, labels, np.zeros(GRID.shape)), density=1000)
    assert len(fragments) == 2
    assert_fills(fragments, shape)
    assert_outside_is_original(fragments, shape)


def test_parts_of_a_label_that_do_not_hang_together_are_fragments():
    shape = slab(0.5)
    x = GRID.centres()[..., 0]
    inside = signed_distance(shape.mesh, GRID) > 0
    labels = np.where(np.abs(x) < 0.3, 2, 1) * inside
    fragments = cut(shape, FracturePattern(GRID, labels, np.zeros(GRID.shape)), density=1000)
    assert len(fragments) == 3
    assert_fills(fragments, shape)


def test_labels_far_from_the_shape_and_dust_change_nothing():
    shape = slab(0.5)
    labels = (signed_distance(shape.mesh, GRID) > 0).astype(np.int32)
    labels[32, 32, 32], labels[0, 0, 0], labels[:, :, :8] = 2, 3, 4
    fragments = cut(shape, FracturePattern(GRID, labels, np.zeros(GRID.shape)), density=1000)
    assert len(fragments) == 1


def test_crumbs_of_the_cut_join_their_neighbours():
    """Eight voxels make a label, but the surface and the crack leave less than one of their volume."""
    top = GRID.to_world(40)
    shape = slab(2 * (top + 0.05 * GRID.spacing))
    labels = (signed_distance(shape.mesh, GRID) > 0).astype(np.int32)
    distance = np.full(GRID.shape, GRID.spacing)
    labels[20:24, 30:32, 40] = 2
    distance[20:24, 30:32, 40] = 0.01 * GRID.spacing
    labels[40:] *= 3
    fragments = cut(shape, FracturePattern(GRID, labels, distance), density=1000)
    assert len(fragments) == 2
    assert_fills(fragments, shape)
    assert_outside_is_original(fragments, shape)


def test_a_fragment_inside_another_leaves_a_void():
    shape = slab(1)
    labels = (signed_distance(shape.mesh, GRID) > 0).astype(np.int32)
    labels[28:36, 28:36, 28:36] = 2
    fragments = cut(shape, FracturePattern(GRID, labels, np.zeros(GRID.shape)), density=1000)
    assert len(fragments) == 2
    assert fragments.volume == pytest.approx(shape.mesh.volume, rel=1e-6)
    small, large = sorted(piece.volume for piece in fragments)
    assert small == pytest.approx(8**3 * GRID.spacing**3, rel=0.2)
    assert large == pytest.approx(shape.mesh.volume - small, rel=1e-6)


def test_open_mesh_and_bad_density_are_refused():
    shape, pattern = ball(), cells(ball(), 2)
    torn = Shape("torn", Mesh(shape.mesh.vertices, shape.mesh.faces[1:]))
    with pytest.raises(BadInput, match="torn: cannot be cut"):
        cut(torn, pattern, density=1000)
    with pytest.raises(BadInput, match="density"):
        cut(shape, pattern, density=0)
