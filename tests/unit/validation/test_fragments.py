"""What a set of fragments must satisfy: a box in two halves does, and each thing that can be wrong is told."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from deepfracture.types import BadInput, FracturePattern, Fragment, Fragments, Ints, Mesh, Shape
from deepfracture.validation.fragments import FragmentReport, _partners, check_fragments
from deepfracture.validation.meshes import box, concatenated, inverted

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
VOXEL = 2 / 64
SHAPE = Shape("box", box((2, 1, 1), (4, 2, 2)))


def piece(mesh: Mesh, source: Ints) -> Fragment:
    return Fragment(mesh, source, 1.0, np.zeros(3), np.eye(3))


def halves() -> list[Fragment]:
    """The box parted at x = 0, where its triangles end."""
    mesh, pieces = SHAPE.mesh, []
    middle = np.flatnonzero(mesh.vertices[:, 0] == 0)
    points = mesh.vertices[middle]
    # The fan starts in the middle of a side: none of its triangles is flat.
    ring = np.roll(middle[np.argsort(np.arctan2(points[:, 2], points[:, 1]))], 1)
    cap = np.array([(ring[0], ring[i], ring[i + 1]) for i in range(1, len(ring) - 1)])
    for side in (-1, 1):
        own = np.flatnonzero(side * mesh.triangles.mean(axis=1)[:, 0] > 0)
        faces = np.concatenate([mesh.faces[own], cap[:, ::-side]])
        used, faces = np.unique(faces, return_inverse=True)
        source = np.concatenate([own, np.full(len(cap), -1)])
        pieces.append(piece(Mesh(mesh.vertices[used], faces.reshape(-1, 3)), source))
    return pieces


def check(pieces: Sequence[Fragment], shape: Shape = SHAPE) -> FragmentReport:
    return check_fragments(shape, Fragments(tuple(pieces)), voxel=VOXEL)


def moved(fragment: Fragment, vertex: int, by: Sequence[float]) -> Fragment:
    vertices = fragment.mesh.vertices.copy()
    vertices[vertex] += by
    return piece(Mesh(vertices, fragment.mesh.faces), fragment.source)


def at(fragment: Fragment, *place: float) -> int:
    return int(np.argmin(np.linalg.norm(fragment.mesh.vertices - place, axis=1)))


def test_halves_of_a_box_are_sound() -> None:
    report = check(halves())
    assert report.failures == {}
    assert report.volume_error == pytest.approx(0, abs=1e-12)
    assert report.outside.faces == len(SHAPE.mesh.faces)
    assert report.cracks.faces == 2 * 6
    assert report.cracks.bends == pytest.approx((0, 0, 0), abs=1e-6)
    for one in report.pieces:
        assert (one.torn, one.pinched, one.bodies, one.stray, one.crossings, one.euler) == (0, 0, 1, 0, 0, 2)
        assert one.volume == pytest.approx(1)
        assert one.shortest == pytest.approx(0.5 / VOXEL)
        assert (one.short, one.low) == (0, 0)


def test_a_missing_and_a_doubled_face_tear_the_surface() -> None:
    left, right = halves()
    short = piece(Mesh(left.mesh.vertices, left.mesh.faces[1:]), left.source[1:])
    report = check([short, right])
    assert report.pieces[0].torn == 3
    assert report.outside.missing == 1
    assert {"torn", "volume", "outside missing"} <= set(report.failures)
    doubled = [0, *range(len(left.source))]
    twice = piece(Mesh(left.mesh.vertices, left.mesh.faces[doubled]), left.source[doubled])
    assert check([twice, right]).pieces[0].torn > 0


def test_a_pinch_has_two_fans() -> None:
    left, right = halves()
    tip = box((0.1, 0.1, 0.1), (1, 1, 1)).moved(1.0, [-1.05, 0.55, 0.55])
    both = concatenated(left.mesh, tip)
    corner, other = at(left, -1, 0.5, 0.5), len(left.mesh.vertices) + int(np.argmax(tip.vertices @ [1, -1, -1]))
    assert both.vertices[corner] == pytest.approx(both.vertices[other])
    source = np.concatenate([left.source, np.full(len(tip.faces), -1)])
    joined = Mesh(both.vertices, np.where(both.faces == other, corner, both.faces))
    one = check([piece(joined, source), right]).pieces[0]
    assert (one.torn, one.pinched, one.bodies) == (0, 1, 2)
    assert one.euler == 3  # two balls that share a vertex
    apart = check([piece(both, source), right]).pieces[0]
    assert (apart.pinched, apart.bodies, apart.crossings) == (0, 2, 0)


def test_voids_belong_inside() -> None:
    left, right = halves()
    bubble = inverted(box((0.2, 0.2, 0.2), (1, 1, 1)))

    def with_bubble(x: float) -> FragmentReport:
        mesh = concatenated(left.mesh, bubble.moved(1.0, [x, 0, 0]))
        return check([piece(mesh, np.concatenate([left.source, np.full(12, -1)])), right])

    inside, outside = with_bubble(-0.5), with_bubble(0.6)
    assert (inside.pieces[0].bodies, inside.pieces[0].stray, inside.pieces[0].euler) == (1, 0, 4)
    assert outside.pieces[0].stray == 1
    assert "apart" not in inside.failures
    assert outside.failures["apart"] == 1
    assert inside.failures["crack alone"] == 12


@pytest.mark.parametrize(("way", "stray"), [(1, 0), (-1, 1)])
def test_a_void_may_touch_the_surface_around_it(way: int, stray: int) -> None:
    """At the corner that comes first, which is neither inside nor outside."""
    solid = box((2, 2, 2), (2, 2, 2))
    touching = solid.vertices[solid.faces[0, 0]]
    ends = (1 - 0.4 * way) * touching + np.diag([0.2, 0.2, 0.2])
    void = Mesh(np.concatenate([[touching], ends]), np.array([(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]))
    void = inverted(void) if void.volume > 0 else void
    void = Mesh(void.vertices, np.roll(void.faces, -np.argwhere(void.faces[0] == 0)[0, 0], axis=1))
    report = check([piece(concatenated(solid, void), np.full(len(solid.faces) + 4, -1))], Shape("box", solid))
    assert void.faces[0, 0] == 0 and (report.pieces[0].bodies, report.pieces[0].stray) == (1, stray)


def test_inside_out_and_crossing_surfaces() -> None:
    left, right = halves()
    turned = check([piece(inverted(left.mesh), left.source), right]).failures
    assert turned["inside out"] == 1
    assert turned["outside flipped"] == (left.source >= 0).sum()
    pushed = moved(left, at(left, -1, 0, 0), [1.5, 0.1, 0.1])
    assert check([pushed, right]).failures["crossing"] == 1


def test_crossings_of_the_original_are_inherited() -> None:
    left, right = halves()
    by = [0.3, 0.6, 0.1]
    vertices = SHAPE.mesh.vertices.copy()
    vertices[int(np.argmin(np.linalg.norm(vertices - [-1, 0, 0], axis=1)))] += by
    tangled = Shape("tangled", Mesh(vertices, SHAPE.mesh.faces))
    pieces = [moved(left, at(left, -1, 0, 0), by), right]
    report = check(pieces, tangled)
    assert report.failures == {}
    assert report.pieces[0].inherited > 0
    assert check(pieces).pieces[0].crossings == report.pieces[0].inherited
    assert check(pieces).failures["crossing"] == 1


def test_what_moved_outside_is_measured() -> None:
    left, right = halves()
    report = check([moved(left, at(left, -1, 0, 0), [-1e-3, 0, 0]), right])
    assert report.outside.distance == pytest.approx(1e-3)
    assert report.failures["outside moved"] == 1
    slid = check([moved(left, at(left, -1, 0, 0), [0, 0.1, 0]), right])
    assert slid.outside.distance == pytest.approx(0.1 * np.sqrt(0.5), rel=0.5)
    assert slid.volume_error == pytest.approx(0, abs=1e-12)
    assert slid.failures["outside missing"] > 0


def test_neighbours_must_hold_the_same_crack_bit_for_bit() -> None:
    left, right = halves()
    report = check([moved(left, at(left, 0, 0, 0.5), [1e-15, 0, 0]), right])
    assert 0 < report.failures["crack alone"] < report.cracks.faces
    assert set(report.failures) == {"crack alone"}
    gone = check([left])
    assert gone.failures["crack alone"] == 6
    # Both sides on one fragment are no neighbours.
    folded = Mesh(left.mesh.vertices, np.concatenate([left.mesh.faces, left.mesh.faces[left.source < 0][:, ::-1]]))
    assert check([piece(folded, np.concatenate([left.source, np.full(6, -1)]))]).cracks.alone == 12


def test_small_triangles_are_counted() -> None:
    left, right = halves()
    gap = 1e-6
    one, other = check([moved(left, at(left, -1, 0, 0), [0, 0, 0.5 - gap]), right]).pieces
    assert one.shortest == pytest.approx(gap / VOXEL, rel=1e-3)
    assert one.short == pytest.approx(1 / (1.5 * one.faces))
    assert 0.1 * gap < one.lowest * VOXEL < gap
    assert 2 / one.faces <= one.low < 5 / one.faces
    assert other.low == 0


def patch(height: np.ndarray) -> list[Fragment]:
    """The two sides of a crack over a square of voxels, heights in voxels."""
    n = len(height)
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    points = VOXEL * np.stack([x, y, height], axis=-1).reshape(-1, 3)
    a = (x * n + y)[:-1, :-1].ravel()
    faces = np.concatenate([np.stack([a, a + n, a + n + 1], axis=1), np.stack([a, a + n + 1, a + 1], axis=1)])
    none = np.full(len(faces), -1)
    return [piece(Mesh(points, faces), none), piece(Mesh(points, faces[:, ::-1]), none)]


def test_voxel_stairs_are_rougher_than_slopes_and_gentle_curves() -> None:
    x = np.arange(24.0)[:, None] + np.zeros(24)
    slope = check(patch(0.37 * x)).cracks
    curve = check(patch((x - 12) ** 2 / 60)).cracks
    stairs = check(patch(np.floor(0.37 * x))).cracks
    assert slope.alone == curve.alone == stairs.alone == 0
    assert slope.roughness < 1e-9
    assert slope.bends == pytest.approx((0, 0, 0), abs=1e-5)
    assert 0 < curve.roughness < 0.05 < 0.15 < stairs.roughness
    assert curve.bends[2] < 3
    assert stairs.bends[2] == pytest.approx(45, abs=1)


def test_bad_input_is_named() -> None:
    with pytest.raises(BadInput, match="there are none"):
        check([])
    with pytest.raises(BadInput, match="voxel must be positive"):
        check_fragments(SHAPE, Fragments(tuple(halves())), voxel=0)
    with pytest.raises(BadInput, match="source must index"):
        check(halves(), Shape("small", box((2, 1, 1), (1, 1, 1))))


def test_the_benchmark_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import fragments as program

    data = tmp_path / "data"
    data.mkdir()
    data.joinpath("sheet.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")

    def run(fields: int) -> dict[str, dict]:
        table = program.fragments(
            shapes=("bar", "sheet"), fields=fields, resolution=32, kinds=("cells", "hostile"), data=data, out=tmp_path
        )
        assert table.read_text().count("\n| bar | 1100 |") == 1
        return json.loads((tmp_path / "fragments.json").read_text())

    first = run(2)
    assert [row["kind"] for row in first["bar"]["fields"]] == ["cells", "hostile"]
    assert first["bar"]["fields"][0]["fragments"] > 1
    assert first["sheet"]["refused"].startswith("sheet.obj: ")

    def broken(shape: Shape, pattern: FracturePattern, *, density: float) -> Fragments:
        if pattern.count > 1:
            raise ZeroDivisionError("no luck")
        return Fragments((piece(inverted(shape.mesh), np.arange(len(shape.mesh.faces))),))

    monkeypatch.setattr(program, "cut", broken)
    more = run(4)
    assert more["bar"]["fields"][:2] == first["bar"]["fields"]
    crashed, turned = more["bar"]["fields"][2:]
    assert crashed["crash"] == "ZeroDivisionError: no luck"
    assert {"volume", "inside out", "outside flipped"} <= set(turned["failures"])
    kept = np.load(tmp_path / "r32-s0" / "bar" / "cells-001.npz")
    assert kept["labels"].max() > 1
    text = (tmp_path / "fragments.md").read_text()
    assert "- bar cells-001: ZeroDivisionError: no luck" in text
    assert "- bar hostile-001: " in text


def test_a_crack_face_with_two_corners_in_one_place_fits_its_mate() -> None:
    points = np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    inward, outward = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 2, 1], [0, 3, 2]])
    faces = np.concatenate([inward, outward])
    _, corner = np.unique(points, axis=0, return_inverse=True)
    assert (_partners(corner.ravel()[faces], np.array([0, 0, 1, 1]), np.zeros(4, bool)) == [2, 3, 0, 1]).all()
    assert (
        _partners(corner.ravel()[faces], np.array([0, 0, 0, 1]), np.zeros(4, bool)) == [-1, 3, -1, 1]
    ).all()  # of one fragment
    assert (_partners(corner.ravel()[faces[:3]], np.array([0, 0, 1]), np.zeros(3, bool)) == [2, -1, 0]).all()


def test_crack_faces_with_the_same_corners_fit_if_the_neighbour_has_as_many_mirrored() -> None:
    forth, back = [0, 1, 2], [0, 2, 1]
    faces = np.array([forth, forth, back, back, back, forth])
    partner = _partners(faces, np.array([0, 0, 0, 1, 1, 1]), np.ones(6, bool))
    assert (partner[partner] == np.arange(6)).all() and sorted(partner[:3]) == [3, 4, 5]
    assert all((faces[p] == [f[0], f[2], f[1]]).all() for f, p in zip(faces, partner, strict=True))
    assert (
        _partners(faces, np.array([0, 0, 0, 1, 1, 2]), np.ones(6, bool)) == -1
    ).any()  # a third fragment between them
    assert (_partners(faces[:5], np.array([0, 0, 0, 1, 1]), np.ones(5, bool)) == -1).any()  # one missing
    wide = _partners(faces, np.array([0, 0, 0, 1, 1, 1]), np.zeros(6, bool))
    assert (wide == -1).all()  # whatever has a width must be alone with its mate
