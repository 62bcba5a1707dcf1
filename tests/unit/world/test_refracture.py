"""Fragments as shapes of their own: there and back, and the laws of similarity in between."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import numpy as np
import pytest

from deepfracture.breakers.learned import Learned
from deepfracture.breakers.refracture import impact_on_whole, pattern_on_fragment
from deepfracture.carve import encode
from deepfracture.fracture import FragmentSimulator, critical_stress, material, prepare_fragment, rescale_material
from deepfracture.fracture.contact import contacts
from deepfracture.fracture.similarity import MAX_PREPARED
from deepfracture.geometry import mass_properties
from deepfracture.types import FracturePattern, Fragment, Fragments, Grid, Impact, Mesh, Shape, Volume
from deepfracture.world.refracture import fragment_as_shape, fragments_to_whole, impact_to_fragment

PLASTER = material("plaster")


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    return Mesh(low + corners * (np.array(high) - low), faces)


def _fragment(mesh: Mesh, source: np.ndarray | None = None) -> Fragment:
    have = mass_properties(mesh, PLASTER.density)
    return Fragment(
        mesh, np.arange(len(mesh.faces)) if source is None else source, have.mass, have.centre, have.inertia
    )


WHOLE = Shape("beam", _box((-1, -0.4, -0.3), (1, 0.4, 0.3)), scale=30.0, centre=np.array([100.0, 0.0, -5.0]))
CORNER = _fragment(_box((0.5, -0.4, 0.0), (1.0, 0.1, 0.3)), np.array([7, -1, 3, -1, 5, -1, 9, -1, 11, -1, 2, -1]))
PIECE = fragment_as_shape(CORNER, "corner", WHOLE)


def test_a_piece_has_a_frame_of_its_own_and_knows_the_way_back() -> None:
    np.testing.assert_allclose(np.ptp(PIECE.mesh.bounds, axis=0).max(), 2)
    np.testing.assert_allclose(PIECE.mesh.bounds.sum(axis=0), 0, atol=1e-12)
    assert PIECE.size == pytest.approx(0.25)
    assert PIECE.whole is WHOLE
    np.testing.assert_allclose(PIECE.to_user(PIECE.mesh.vertices), WHOLE.to_user(CORNER.mesh.vertices), atol=1e-12)


def test_what_a_piece_breaks_into_is_real_again() -> None:
    """Halves cut in the piece's frame have the place, mass and inertia of halves cut in the whole's."""
    low, high = PIECE.mesh.bounds
    middle = (low + high) / 2
    cracked = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, -1, -1, 11])
    halves = [
        _fragment(_box(tuple(low), (middle[0], high[1], high[2])), cracked),
        _fragment(_box((middle[0], low[1], low[2]), tuple(high))),
    ]
    back = list(fragments_to_whole(Fragments(tuple(halves)), PIECE, CORNER.source))
    expected = [_box((0.5, -0.4, 0.0), (0.75, 0.1, 0.3)), _box((0.75, -0.4, 0.0), (1.0, 0.1, 0.3))]
    for piece, mesh in zip(back, expected, strict=True):
        have = mass_properties(mesh, PLASTER.density)
        np.testing.assert_allclose(piece.mesh.bounds, mesh.bounds, atol=1e-12)
        assert piece.mass == pytest.approx(have.mass)
        np.testing.assert_allclose(piece.centre, have.centre, atol=1e-12)
        np.testing.assert_allclose(piece.inertia, have.inertia, rtol=1e-9, atol=1e-9)
    assert sum(piece.mass for piece in back) == pytest.approx(CORNER.mass)
    # Faces of the piece's outside are named by the triangle of the whole, its old and new cracks by -1.
    assert back[0].source.tolist() == [7, -1, 3, -1, 5, -1, 9, -1, 11, -1, -1, -1]
    assert back[1].source.tolist() == CORNER.source.tolist()


def test_scaled_impacts_keep_stress_and_scale_time() -> None:
    """Geometrically similar bodies of one material struck at one speed have the same stress (here: under the
    contact), and the contact lasts in proportion to the size."""
    normal = np.array([[0.0, 0.0, 1.0]])
    impact = Impact(np.array([[0.7, -0.1, 0.3]]), -normal, np.array([40.0]), normal, speed=6.0, radius=0.2)
    small = impact_to_fragment(impact, PIECE)
    s = PIECE.size
    np.testing.assert_allclose(PIECE.to_user(small.position), WHOLE.to_user(impact.position))
    assert small.magnitude[0] == pytest.approx(40.0 / s**3)
    area = float(np.linalg.norm(CORNER.mesh.area_vectors, axis=1).sum())
    own_area = float(np.linalg.norm(PIECE.mesh.area_vectors, axis=1).sum())
    assert critical_stress(small, PLASTER, own_area) == pytest.approx(critical_stress(impact, PLASTER, area))
    (before,), (after,) = contacts(impact, PLASTER), contacts(small, PLASTER)
    assert after.duration == pytest.approx(before.duration / s)
    assert after.radius == pytest.approx(before.radius / s)
    assert after.force == pytest.approx(before.force / s**2)


def test_similar_materials_keep_the_strength_and_griffiths_ratio() -> None:
    s = 0.25
    own = rescale_material(PLASTER, s)
    assert (own.strength, own.young, own.density, own.poisson) == (
        PLASTER.strength, PLASTER.young, PLASTER.density, PLASTER.poisson,
    )  # fmt: skip
    # A crack of length a becomes a / s: stress sqrt(a) / K must not change.
    assert (0.1 / s) ** 0.5 / own.toughness == pytest.approx(0.1**0.5 / PLASTER.toughness)
    assert own.variation_length * s == pytest.approx(PLASTER.variation_length)
    assert own.roughness * s == pytest.approx(PLASTER.roughness)


def test_a_piece_is_prepared_coarsely_and_not_kept(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    body = prepare_fragment(PIECE, PLASTER, Grid(128))
    assert body.grid.resolution == 32  # 128 voxels over the whole are 32 over a quarter of it
    assert 300 < len(body.elastic.mesh.faces) < 800
    assert body.material == rescale_material(PLASTER, PIECE.size)
    assert not list(tmp_path.rglob("*"))


def _slabs(*cuts: float) -> tuple[FracturePattern, np.ndarray]:
    """The beam in slabs across x, and its distance to the surface."""
    grid = Grid(64)
    x = grid.centres()
    surface = (np.array([1, 0.4, 0.3]) - np.abs(x)).min(axis=-1).astype(np.float32)
    labels = np.where(surface > 0, 1 + sum((x[..., 0] > cut).astype(int) for cut in cuts), 0)
    away = np.min([np.abs(x[..., 0] - cut) for cut in cuts], axis=0)
    return FracturePattern(grid, labels, away), surface


def test_a_piece_takes_what_a_pattern_of_the_whole_does_within_it() -> None:
    """Planes across the beam: one within the corner (0.5 to 1), one not."""
    pattern, _ = _slabs(-0.3, 0.613)
    own = pattern_on_fragment(pattern, PIECE)
    assert own.grid.resolution == 32  # voxels no larger than the whole's
    assert own.count == 2
    x = own.grid.centres()[..., 0] * PIECE.size + 0.75
    inside = own.labels > 0
    assert ((own.labels == own.labels.max()) == (x > 0.613))[inside].all()  # finer than a voxel of the whole
    np.testing.assert_allclose((own.distance * PIECE.size)[inside], np.abs(x - 0.613)[inside], atol=0.017)


def _blow(strength: float) -> Impact:
    normal = np.array([[0.0, 0.0, 1.0]])
    return Impact(np.array([[0.6, -0.1, 0.3]]), -normal, np.array([strength]), normal, speed=6.0, radius=0.2)


def test_a_blow_on_a_piece_is_one_on_the_whole_at_the_same_place() -> None:
    own = impact_to_fragment(_blow(40.0), PIECE)
    there = impact_on_whole(own, PIECE)
    np.testing.assert_allclose(there.position, _blow(40.0).position)
    assert there.magnitude[0] == pytest.approx(own.magnitude[0])  # as strong as it is for the piece


def test_a_model_of_the_whole_breaks_a_piece_within_bounds() -> None:
    asked: list[Impact] = []

    def predictions(impact: Impact, rng: np.random.Generator) -> Iterator[Volume]:
        asked.append(impact)
        for cuts in ((-0.3,), (-0.3, 0.613)):  # the first parts the piece nowhere
            yield encode(*_slabs(*cuts))

    learned = Learned(predictions, weakest_impulse=1000.0)
    rng = np.random.default_rng(0)
    broken = learned(PIECE, impact_to_fragment(_blow(40.0), PIECE), rng)
    assert broken is not None
    assert broken.count == 2
    assert (
        learned(PIECE, impact_to_fragment(_blow(10.0), PIECE), rng) is None
    )  # 640 in its own frame: a model knows no such blow
    assert len(asked) == 1
    whole = learned(WHOLE, _blow(10.0), rng)
    assert whole is not None
    assert whole.count == 2
    np.testing.assert_array_equal(asked[1].position, _blow(10.0).position)


def test_a_fragment_is_not_taken_for_another_that_is_gone() -> None:
    """Prepared fragments are known by their identity, so they must outlive it; but not for ever."""
    pieces = FragmentSimulator(PLASTER, Grid(32))
    blow = Impact(
        np.array([[1.0, 0, 0]]),
        np.array([[-1.0, 0, 0]]),
        np.array([1e6]),
        np.array([[1.0, 0, 0]]),
        speed=50.0,
        radius=0.1,
    )
    seen = []
    for number in range(2 * MAX_PREPARED):
        thin = fragment_as_shape(
            _fragment(_box((0.5, 0, 0), (1.0, 0.1, 1e-5 * (1 + number)))), f"sliver {number}", WHOLE
        )
        assert pieces(thin, blow, np.random.default_rng(0)) is None
        seen.append(weakref.ref(thin))
        del thin
        gc.collect()
        assert seen[-1]() is not None
    assert sum(left() is not None for left in seen) == MAX_PREPARED
