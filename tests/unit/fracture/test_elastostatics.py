"""What the elastostatic solver takes, refuses and keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepfracture.fracture.elastostatics import ElasticBody, prepare, solve
from deepfracture.fracture.interior import stress_at, surface_stress
from deepfracture.types import BadInput, Mesh

OCTAHEDRON = Mesh(
    np.concatenate([np.eye(3), -np.eye(3)]),
    [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]],
)


@pytest.fixture(scope="module")
def body() -> ElasticBody:
    return prepare(OCTAHEDRON, 0.25)


def test_saved_body_gives_the_same_bytes(body: ElasticBody, tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    body.save(path)
    assert [file.name for file in tmp_path.iterdir()] == ["body.npz"]
    again = ElasticBody.load(path)
    load = np.random.default_rng(0).normal(size=(8, 3))
    ours, theirs = solve(body, load), solve(again, load)
    assert (ours.displacement == theirs.displacement).all()
    point = np.array([[0.1, 0.2, -0.1]])
    assert (stress_at(ours, point) == stress_at(theirs, point)).all()


def test_prepare_is_reproducible(body: ElasticBody) -> None:
    again = prepare(OCTAHEDRON, 0.25)
    assert (again.factor == body.factor).all()
    assert (again.single_layer == body.single_layer).all()


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x05\x06" + 18 * b"\0"])
def test_load_refuses_other_files(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with pytest.raises(BadInput, match="not a saved elastic body"):
        ElasticBody.load(path)


@pytest.mark.parametrize(
    ("mesh", "poisson", "message"),
    [
        (OCTAHEDRON, 0.5, "poisson"),
        (Mesh(OCTAHEDRON.vertices, OCTAHEDRON.faces[1:]), 0.25, "not closed"),
        (Mesh(OCTAHEDRON.vertices, OCTAHEDRON.faces[:, ::-1]), 0.25, "outward"),
        (Mesh(OCTAHEDRON.vertices * [1, 1, 0], OCTAHEDRON.faces), 0.25, "no area|volume"),
        (Mesh(np.concatenate([OCTAHEDRON.vertices, [[9.0, 9, 9]]]), OCTAHEDRON.faces), 0.25, "no triangle"),
    ],
)
def test_prepare_refuses(mesh: Mesh, poisson: float, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        prepare(mesh, poisson)


def test_solve_refuses_wrong_tractions(body: ElasticBody) -> None:
    with pytest.raises(BadInput, match="shape"):
        solve(body, np.zeros((7, 3)))
    with pytest.raises(BadInput, match="finite"):
        solve(body, np.full((8, 3), np.nan))


def test_no_load_gives_no_stress(body: ElasticBody) -> None:
    rest = solve(body, np.zeros((8, 3)))
    assert not surface_stress(rest).any()
    assert not stress_at(rest, [[0.0, 0, 0]]).any()


def test_stress_is_linear_in_the_load(body: ElasticBody) -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 8, 3))
    points = rng.uniform(-0.2, 0.2, (5, 3))
    apart = 2 * stress_at(solve(body, a), points) - 3 * stress_at(solve(body, b), points)
    assert stress_at(solve(body, 2 * a - 3 * b), points) == pytest.approx(apart, abs=1e-6)


def test_stress_is_finite_on_and_outside_the_surface(body: ElasticBody) -> None:
    solution = solve(body, np.random.default_rng(2).normal(size=(8, 3)))
    vertices, centres = body.mesh.vertices, body.panels.centres
    middles = body.mesh.triangles[:, :2].mean(axis=1)
    points = np.concatenate([vertices, middles, centres, 1.01 * centres, 2 * vertices])
    assert np.isfinite(stress_at(solution, points)).all()


def test_stress_refuses_wrong_points(body: ElasticBody) -> None:
    solution = solve(body, np.zeros((8, 3)))
    with pytest.raises(BadInput, match="points"):
        stress_at(solution, [0.0, 0, 0])
    assert stress_at(solution, np.zeros((0, 3))).shape == (0, 6)
