"""An artist's surface survives breaking: what each corner of a fragment has is what the whole has there."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture.geometry import builtin, load_shape
from deepfracture.geometry.appearance import INNER, barycentric, fragment_appearance, planar_uv, transfer_appearance
from deepfracture.types import Appearance, BadInput, Finish, Fragments, Mesh, Shape
from deepfracture.world.refracture import fragment_as_shape, fragments_to_whole

tools = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "painted.py"))
TURN = np.array([[0.3, -0.5, 0.2], [0.4, 0.1, -0.6]])


def wild(faces: int, seed: int = 1) -> Appearance:
    """Every corner of every face has something of its own."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(faces, 3, 3)) + np.array([0, 0, 4])
    return Appearance(
        rng.integers(0, 3, faces),
        (Finish("glaze"), Finish("wax"), Finish("gilt")),
        normals / np.linalg.norm(normals, axis=2, keepdims=True),
        rng.uniform(-2, 3, (faces, 3, 2)),
        rng.integers(0, 256, (faces, 3, 4)),
    )


def check_outside(look: Appearance, given: Appearance, whole: Mesh, mesh: Mesh, source: np.ndarray) -> int:
    """Compare every outer corner with the interpolation at its place; returns how many faces there are."""
    outer = np.flatnonzero(source >= 0)
    old = source[outer]
    ones = np.ones((len(outer), 1, 3))
    system = np.concatenate([np.swapaxes(whole.triangles[old], 1, 2), ones], axis=1)
    places = np.concatenate([np.swapaxes(mesh.triangles[outer], 1, 2), ones], axis=1)
    shares = np.swapaxes(np.linalg.pinv(system) @ places, 1, 2)  # of the old corners in each new one
    assert shares.min() > -1e-6
    normals = shares @ given.normals[old]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    assert np.abs(look.normals[outer] - normals).max() < 1e-5
    assert np.abs(look.uv[outer] - shares @ given.uv[old]).max() < 1e-5
    assert np.abs(look.colours[outer] - shares @ given.colours[old]).max() < 0.51
    assert (look.finish[outer] == given.finish[old]).all()
    return len(outer)


@pytest.fixture(scope="module")
def ball() -> Shape:
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=2)
    return Shape("ball", Mesh(sphere.vertices, sphere.faces))


@pytest.fixture(scope="module")
def pieces(ball) -> Fragments:
    return tools["broken"](ball)


def test_every_outer_corner_has_what_the_whole_has_there(ball, pieces):
    given = wild(len(ball.mesh.faces))
    counts = [
        check_outside(
            fragment_appearance(given, ball.mesh, piece.mesh, piece.source), given, ball.mesh, piece.mesh, piece.source
        )
        for piece in pieces
    ]
    assert len(counts) >= 5 and sum(counts) > len(ball.mesh.faces)


def test_a_linear_coordinate_stays_linear(ball, pieces):
    uv = ball.mesh.triangles @ TURN.T
    given = Appearance(np.zeros(len(uv), int), uv=uv)
    for piece in pieces:
        outer = piece.source >= 0
        look = fragment_appearance(given, ball.mesh, piece.mesh, piece.source)
        assert np.abs(look.uv[outer] - piece.mesh.triangles[outer] @ TURN.T).max() < 1e-6
        assert look.normals is None and look.colours is None


def test_fragments_of_fragments_refer_to_the_whole(ball, pieces):
    given = wild(len(ball.mesh.faces))
    piece = max(pieces, key=lambda p: p.volume)
    shape = fragment_as_shape(piece, "piece", ball)
    again = fragments_to_whole(tools["broken"](shape), shape, piece.source)
    assert len(again) > 1
    for small in again:
        look = fragment_appearance(given, ball.mesh, small.mesh, small.source)
        check_outside(look, given, ball.mesh, small.mesh, small.source)


def test_crack_faces_have_the_stone_and_coordinates_in_metres(ball, pieces):
    given = wild(len(ball.mesh.faces))
    for piece in pieces:
        look = fragment_appearance(given, ball.mesh, piece.mesh, piece.source)
        inner = piece.source < 0
        assert inner.any()
        assert (look.finish[inner] == 3).all() and look.finishes[3] is INNER
        assert (look.colours[inner] == 255).all()
        flat = piece.mesh.area_vectors[inner]
        size = np.linalg.norm(flat, axis=1)
        assert np.einsum("mi,mi->m", look.normals[inner, 0], flat).min() >= 0
        # Two of the three coordinates of each corner, so that nothing is stretched by more than a slant.
        places = piece.mesh.triangles[inner]
        seen = [np.abs(look.uv[inner] - np.delete(places, axis, axis=2)).max(axis=(1, 2)) < 1e-6 for axis in range(3)]
        assert np.any(seen, axis=0).all()
        a, b, c = np.moveaxis(look.uv[inner].astype(float), 1, 0)
        area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
        assert area.sum() > 0.6 * size.sum()
        assert size[area < 0.4 * size].sum() < 0.1 * size.sum()


def test_both_sides_of_a_crack_have_the_same_coordinates(ball, pieces):
    grain: dict[tuple, np.ndarray] = {}
    same, met = 0.0, 0.0
    for piece in pieces:
        inner = piece.source < 0
        uv = planar_uv(piece.mesh, inner)
        for face in np.flatnonzero(inner):
            corners = piece.mesh.triangles[face]
            order = np.lexsort(corners.T)
            key = tuple(np.round(corners[order], 9).ravel())
            if key in grain:
                met += 1
                same += np.abs(grain[key] - uv[face][order]).max() < 1e-6
            grain[key] = uv[face][order]
    assert met > 100
    assert same > 0.9 * met


def test_rounding_never_leaves_the_triangle():
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    shares = barycentric(triangle, np.array([[[1 + 1e-9, -1e-9, 1e-9], [0.5, 0.5 + 1e-9, 0], [0.25, 0.25, 0.1]]]))
    assert shares.min() >= 0
    np.testing.assert_allclose(shares.sum(axis=2), 1, atol=1e-15)
    np.testing.assert_allclose(shares[0], [[0, 1, 0], [0, 0.5, 0.5], [0.5, 0.25, 0.25]], atol=1e-8)


@pytest.mark.parametrize(
    "triangle",
    [[[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], [[0, 0, 0], [0.5, 0, 0], [1, 0, 0]], [[0.5, 0, 0], [0, 0, 0], [1, 0, 0]]],
)
def test_a_triangle_without_area_counts_as_its_longest_side(triangle):
    places = np.array([[[0.0, 0, 0], [0.25, 0, 0], [1, 0, 0]]])
    shares = barycentric(np.array([triangle], float), places)
    assert shares.min() >= 0
    np.testing.assert_allclose(shares @ np.array(triangle, float), places, atol=1e-12)
    point = barycentric(np.zeros((1, 3, 3)), places)
    np.testing.assert_allclose(point.sum(axis=2), 1)


def test_a_cleaned_mesh_keeps_the_corners_of_its_faces():
    """Welded, reordered, renumbered, turned round: every corner still has its own."""
    mesh = builtin("base").mesh
    given = wild(len(mesh.faces))
    rng = np.random.default_rng(5)
    order, turn = rng.permutation(len(mesh.faces)), rng.integers(0, 3, len(mesh.faces))
    soup = Mesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))
    corner = (np.arange(3) + turn[:, None]) % 3
    corner[::2] = corner[::2, ::-1]
    faces = np.take_along_axis(mesh.faces[order], corner, axis=1)
    look, new = transfer_appearance(given, soup, Mesh(mesh.vertices, faces))
    assert new == 0
    np.testing.assert_allclose(look.uv, np.take_along_axis(given.uv[order], corner[:, :, None], axis=1), atol=1e-6)
    assert (look.colours == np.take_along_axis(given.colours[order], corner[:, :, None], axis=1)).all()
    assert (look.finish == given.finish[order]).all()
    # Half of the faces were turned over: normals are on the new outer side.
    flat = Mesh(mesh.vertices, faces).area_vectors
    assert (np.einsum("mki,mi->m", look.normals, flat) >= 0).all()


def test_seams_that_rounding_has_opened_are_no_new_faces(tmp_path, caplog):
    """Each side of the cube with corners of its own, which miss each other by a millionth."""
    path = tools["write_cube"](tmp_path)
    places, rng = np.repeat(tools["CORNERS"], 6, axis=0), np.random.default_rng(0)
    places += rng.uniform(-1e-6, 1e-6, places.shape)
    lines = [line for line in path.read_text().splitlines() if not line.startswith("v ")]
    lines[2:2] = ["v {:.9f} {:.9f} {:.9f}".format(*p) for p in places]
    side = iter(range(6))
    for k, line in enumerate(lines):
        if line.startswith("f "):
            s, corners = next(side), [word.split("/") for word in line.split()[1:]]
            lines[k] = "f " + " ".join(f"{6 * (int(v) - 1) + s + 1}/{uv}/{n}" for v, uv, n in corners)
    path.write_text("\n".join(lines) + "\n")
    with caplog.at_level("INFO", logger="deepfracture"):
        shape = load_shape(str(path))
    assert len(shape.mesh.vertices) == 8 and not caplog.records
    flat = np.repeat(shape.mesh.area_vectors, 3, axis=0)
    want = tools["expected_uv"](shape.mesh.triangles.reshape(-1, 3), flat)
    assert np.abs(shape.appearance.uv.reshape(-1, 2) - want).max() < 1e-5


def test_faces_that_a_repair_adds_are_counted_and_look_like_their_neighbours(tmp_path, caplog):
    path = tools["write_cube"](tmp_path)
    text = path.read_text().splitlines()
    path.write_text("\n".join(text[:-1]) + "\n")  # the last side, +x, is missing
    with pytest.raises(BadInput):
        load_shape(str(path))
    with caplog.at_level("INFO", logger="deepfracture"):
        shape = load_shape(str(path), repair=True)
    assert shape.appearance is not None and shape.mesh.volume == pytest.approx(8)
    said = [r.getMessage() for r in caplog.records if "are new" in r.getMessage()]
    assert len(said) == 1 and "of 14 faces are new" in said[0]
    flat = shape.mesh.area_vectors
    cap = flat[:, 0] > 0.1
    assert cap.sum() == 4
    assert np.abs(shape.appearance.normals[cap] - [1, 0, 0]).max() < 1e-6
    old = ~cap
    places, normals = shape.mesh.triangles[old].reshape(-1, 3), np.repeat(flat[old], 3, axis=0)
    uv = shape.appearance.uv[old].reshape(-1, 2)
    assert np.abs(uv - tools["expected_uv"](places, normals)).max() < 1e-6


def test_an_appearance_fits_its_mesh(ball):
    with pytest.raises(BadInput, match="appearance must be that of the mesh's 320 faces, got 7"):
        replace(ball, appearance=wild(7))
    with pytest.raises(BadInput, match=r"uv must have shape \(4, 3, 2\)"):
        Appearance(np.zeros(4, int), uv=np.zeros((5, 3, 2)))
    with pytest.raises(BadInput, match="finish must index 1 finishes, got 1"):
        Appearance(np.array([0, 1]))
    with pytest.raises(BadInput, match="normals must be finite"):
        Appearance(np.zeros(1, int), normals=np.full((1, 3, 3), np.nan))


def test_a_recording_knows_what_its_fragments_look_like(tmp_path):
    from deepfracture.fracture import material
    from deepfracture.world import Ball, Floor, Placed, Scene, simulate

    shape, fragments = tools["broken_cube"](tmp_path)
    ball = Ball(0.2, 7800.0, (-1.5, 0.0, 1.0), (30.0, 0.0, 0.0))
    placed = Placed("cube", "plaster", (0.0, 0.0, 1.001))
    scene = Scene((placed,), (ball,), Floor(), duration=0.2)
    asked = []
    outcome = simulate(
        scene,
        [shape],
        lambda *args: asked.append(1) or fragments,
        np.random.default_rng(0),
        materials={"plaster": material("plaster")},
    )
    kinds = {
        track.kind: [t.whole for t in outcome.recording.tracks if t.kind == track.kind]
        for track in outcome.recording.tracks
    }
    assert len(kinds["fragment"]) == len(fragments) and asked
    assert all(whole is shape for whole in kinds["fragment"] + kinds.get("shape", []))
    assert kinds["ball"] == [None] and kinds["floor"] == [None]
