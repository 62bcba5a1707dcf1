"""Conservation laws of the boundary elements; their closed forms are cases of `deepfracture.validation`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from deepfracture.fracture.elastostatics import ElasticBody, prepare, solve
from deepfracture.fracture.interior import stress_at
from deepfracture.validation.elastic import POISSON, patch_mesh, pinched, points_inside


@cache
def _body(name: str) -> ElasticBody:
    return prepare(patch_mesh(name, 5), POISSON)


@pytest.mark.parametrize("name", ["cube", "irregular"])
def test_inertia_balances_any_load(name: str) -> None:
    body = _body(name)
    tractions = np.random.default_rng(4).normal(size=(len(body.mesh.faces), 3))
    solution = solve(body, tractions)
    areas = body.panels.areas[:, None]
    arms = body.panels.centres - body.centre
    left = solution.traction * areas
    assert np.abs(left.sum(axis=0)).max() < 1e-8
    assert np.abs(np.cross(arms, left).sum(axis=0)).max() < 1e-8
    # Newton: density times acceleration is force over volume (to how well centroids sum a spin's inertia).
    force = (tractions * areas).sum(axis=0)
    assert solution.acceleration == pytest.approx(force / body.mesh.volume, rel=1e-3)


def test_spin_is_torque_over_inertia() -> None:
    from deepfracture.geometry import mass_properties

    body = _body("cube")
    tractions = np.random.default_rng(5).normal(size=(len(body.mesh.faces), 3))
    torque = np.cross(body.panels.centres - body.centre, tractions * body.panels.areas[:, None]).sum(axis=0)
    exact = np.linalg.solve(mass_properties(body.mesh, 1.0).inertia, torque)
    # One traction a triangle: the moments of the inertia are right to the square of the element size.
    assert solve(body, tractions).spin == pytest.approx(exact, rel=0.03)


def test_fast_interior_follows_closed_form() -> None:
    solution = pinched(_body("sphere"))[0]
    points = points_inside(0.95, 300)
    exact = stress_at(solution, points, far=np.inf)
    fast = stress_at(solution, points)
    assert np.sqrt(((fast - exact) ** 2).mean()) < 0.01 * np.sqrt((exact**2).mean())


def test_stress_does_not_depend_on_scale_or_units() -> None:
    """Tractions a billion times larger on a body a hundred times smaller: stress a billion times larger."""
    body = prepare(patch_mesh("irregular", 5).moved(0.01, [0.0, 0, 0]), POISSON)
    tractions = np.random.default_rng(6).normal(size=(len(body.mesh.faces), 3))
    small = stress_at(solve(body, 1e9 * tractions), body.centre + 0.01 * points_inside(0.3, 20))
    plain = _body("irregular")
    stress = stress_at(solve(plain, tractions), plain.centre + points_inside(0.3, 20))
    assert small / 1e9 == pytest.approx(stress, rel=1e-4, abs=1e-4 * np.abs(stress).max())
