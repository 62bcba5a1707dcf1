"""The boundary elements against closed forms and conservation laws."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from meshes import box, cylinder, icosphere, inverted, jittered, together

from deepfracture.fracture.elastostatics import ElasticBody, Solution, assemble, prepare, solve
from deepfracture.fracture.interior import stress_at, surface_stress
from deepfracture.types import Floats, Mesh

POISSON = 0.3
UNIAXIAL = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def _mesh(name: str) -> Mesh:
    rng = np.random.default_rng(1)
    return {
        "cube": lambda: box((1, 1, 1), (5, 5, 5)),
        "sphere": lambda: icosphere(5),
        "irregular": lambda: jittered(icosphere(5), 0.06, rng).moved(0.7, [3, -2, 1]),
        "plate": lambda: box((2, 2, 0.2), (8, 8, 1)),
    }[name]()


@cache
def _body(name: str) -> ElasticBody:
    return prepare(_mesh(name), POISSON)


def _matrices(voigt: Floats) -> Floats:
    return voigt[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]


def _points_inside(radius: float, count: int = 150) -> Floats:
    points = np.random.default_rng(2).normal(size=(count, 3))
    return points * radius * np.linspace(0.02, 1, count)[:, None] / np.linalg.norm(points, axis=1)[:, None]


@pytest.mark.parametrize("name", ["cube", "sphere", "irregular", "plate"])
def test_uniform_tension(name: str) -> None:
    body = _body(name)
    solution = solve(body, body.panels.normals * [0, 0, 1])
    strain = np.array([-POISSON, -POISSON, 1.0])
    exact = ((body.mesh.vertices - body.centre) * strain).ravel()
    exact -= body.rigid_modes @ (body.rigid_modes.T @ exact)
    error = np.abs(solution.displacement.ravel() - exact).max() / np.abs(exact).max()
    assert error < 1e-3
    assert np.abs(surface_stress(solution) - UNIAXIAL).max() < 1e-3
    thickness = np.ptp(body.mesh.vertices, axis=0).min()
    inside = body.centre + _points_inside(0.35 * thickness)
    assert np.abs(stress_at(solution, inside, far=np.inf) - UNIAXIAL).max() < 1e-3


def test_hollow_sphere_under_inner_pressure() -> None:
    """Lamé: radii 0.5 and 1. The error falls with the element size."""
    errors = []
    for outer, inner in ((4, 3), (7, 5)):
        body = prepare(together(icosphere(outer), inverted(icosphere(inner, 0.5))), POISSON)
        cavity = np.linalg.norm(body.panels.centres, axis=1) < 0.75
        solution = solve(body, np.where(cavity[:, None], -body.panels.normals, 0.0))
        factor = 0.5**3 / (1 - 0.5**3)
        hoop = np.linalg.eigvalsh(_matrices(surface_stress(solution)))[:, 2]
        exact = factor * np.where(cavity, 1 + 1 / (2 * 0.5**3), 1.5)
        errors.append(np.sqrt(((hoop - exact) ** 2).mean()) / exact.max())
    assert errors[1] < 0.03
    assert errors[1] < 0.6 * errors[0]
    radii = np.linspace(0.6, 0.9, 60)
    points = _points_inside(1.0, 60)
    points *= (radii / np.linalg.norm(points, axis=1))[:, None]
    principal = np.linalg.eigvalsh(_matrices(stress_at(solution, points)))
    exact_hoop, exact_radial = factor * (1 + 0.5 / radii**3), factor * (1 - 1 / radii**3)
    assert np.abs(principal[:, 2] - exact_hoop).max() < 0.05 * exact_hoop.max()
    assert np.abs(principal[:, 0] - exact_radial).max() < 0.06 * np.abs(exact_radial).max()


def test_pushed_bar_carries_its_own_inertia() -> None:
    """A bar pulled at one end: exactly σ_xx = p (1/2 + x / L), all else zero."""
    body = prepare(box((2, 0.5, 0.5), (12, 3, 3)), POISSON)
    tractions = np.zeros((len(body.mesh.faces), 3))
    tractions[body.panels.normals[:, 0] > 0.5, 0] = 1.0
    solution = solve(body, tractions)
    assert solution.acceleration == pytest.approx([0.5, 0, 0], abs=1e-12)
    assert np.abs(solution.spin).max() < 1e-12
    points = np.random.default_rng(3).uniform(-1, 1, (100, 3)) * [0.9, 0.18, 0.18]
    exact = np.zeros((100, 6))
    exact[:, 0] = 0.5 + points[:, 0] / 2
    assert np.abs(stress_at(solution, points) - exact).max() < 0.005
    exact = np.zeros((len(body.mesh.faces), 6))
    exact[:, 0] = 0.5 + body.panels.centres[:, 0] / 2
    assert np.abs(surface_stress(solution) - exact).max() < 0.02


def test_twisted_bar_spins_up() -> None:
    """A round bar twisted at one end: exactly the shear stress (1/2 + x / L) x e_x x r."""
    body = prepare(cylinder(0.5, 2, 16, 14), POISSON)
    axis = np.array([1.0, 0, 0])
    tractions = np.zeros((len(body.mesh.faces), 3))
    end = body.panels.normals[:, 0] > 0.9
    tractions[end] = np.cross(axis, body.panels.centres[end])
    solution = solve(body, tractions)
    assert solution.spin == pytest.approx([0.5, 0, 0], abs=0.02)
    assert np.abs(solution.acceleration).max() < 1e-12
    points = np.random.default_rng(3).uniform(-1, 1, (100, 3)) * [0.9, 0.28, 0.28]
    shear = np.cross(axis, points) * (0.5 + points[:, :1] / 2)
    exact = np.zeros((100, 6))
    exact[:, 5], exact[:, 4] = shear[:, 1], shear[:, 2]
    assert np.abs(stress_at(solution, points) - exact).max() < 0.04 * np.abs(exact).max()


def _pinched_sphere() -> Solution:
    body = _body("sphere")
    pole = body.mesh.vertices[0]
    areas = body.panels.areas
    tractions = np.zeros((len(body.mesh.faces), 3))
    for sign in (1, -1):
        tip = int(np.argmax(sign * body.mesh.vertices @ pole))
        cap = (body.mesh.faces == tip).any(axis=1)
        tractions[cap] = -sign * pole / areas[cap].sum()
    return solve(body, tractions)


def test_pinched_sphere() -> None:
    """Two opposite forces F: the centre is pulled apart by 21 / (28 + 20 ν) F / (π R^2) and pressed
    together by (42 + 15 ν) / (14 + 10 ν) F / (π R^2) (Sternberg & Rosenthal 1952)."""
    stress = stress_at(_pinched_sphere(), np.zeros((1, 3)))
    principal = np.linalg.eigvalsh(_matrices(stress))[0] * np.pi
    tension, pressure = 21 / (28 + 20 * POISSON), -(42 + 15 * POISSON) / (14 + 10 * POISSON)
    # The caps are 0.2 wide and the mesh has 500 triangles.
    assert principal == pytest.approx([pressure, tension, tension], rel=0.05)


@pytest.mark.parametrize("name", ["irregular", "plate"])
def test_rigid_motion_has_no_traction_and_no_stress(name: str) -> None:
    body = _body(name)
    double, _ = assemble(body.mesh, body.panels, POISSON)
    scale = np.abs(np.diag(double)).mean()
    translations = np.tile(np.eye(3), (len(body.mesh.vertices), 1))
    assert np.abs(double @ translations).max() < 1e-8 * scale
    nothing, offsets = np.zeros((len(body.mesh.faces), 3)), body.mesh.vertices - body.centre
    moved = np.array([0.3, -0.2, 0.5]) + np.cross([0.4, 0.1, -0.7], offsets)
    still = Solution(body, nothing, moved, np.zeros(3), np.zeros(3))
    thickness = np.ptp(body.mesh.vertices, axis=0).min()
    inside = body.centre + _points_inside(0.3 * thickness, 40)
    assert np.abs(surface_stress(still)).max() < 1e-8
    assert np.abs(stress_at(still, inside, far=np.inf)).max() < 1e-8


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
    solution = _pinched_sphere()
    points = _points_inside(0.95, 300)
    exact = stress_at(solution, points, far=np.inf)
    fast = stress_at(solution, points)
    assert np.sqrt(((fast - exact) ** 2).mean()) < 0.01 * np.sqrt((exact**2).mean())


def test_stress_does_not_depend_on_scale_or_units() -> None:
    """Tractions a billion times larger on a body a hundred times smaller: stress a billion times larger."""
    body = prepare(_mesh("irregular").moved(0.01, [0.0, 0, 0]), POISSON)
    tractions = np.random.default_rng(6).normal(size=(len(body.mesh.faces), 3))
    small = stress_at(solve(body, 1e9 * tractions), body.centre + 0.01 * _points_inside(0.3, 20))
    plain = _body("irregular")
    stress = stress_at(solve(plain, tractions), plain.centre + _points_inside(0.3, 20))
    assert small / 1e9 == pytest.approx(stress, rel=1e-4, abs=1e-4 * np.abs(stress).max())
