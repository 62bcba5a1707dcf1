"""Hertz's closed forms against the equation of motion, and the load's resultants."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import box, icosphere

from deepfracture.fracture.contact import contacts, effective_modulus, hertz, tractions
from deepfracture.fracture.materials import material
from deepfracture.types import Impact


def _impact(magnitude: float = 300.0, *, tilt: float = 0.0) -> Impact:
    direction = np.array([[np.sin(tilt), 0, -np.cos(tilt)]])
    return Impact([[0.0, 0, 1]], direction, [magnitude], [[0.0, 0, 1]], speed=8.0, radius=0.1)


def test_hertz_duration_and_patch_from_the_motion() -> None:
    """Integrate m δ'' = -4/3 E* sqrt(R) δ^(3/2): its duration and its deepest compression."""
    from scipy.integrate import solve_ivp

    stone, impulse, speed, radius = material("stone"), 50.0, 6.0, 0.08
    stiffness = 4 / 3 * effective_modulus(stone) * radius**0.5
    mass = impulse / speed

    def motion(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -stiffness * max(state[0], 0.0) ** 1.5 / mass]

    def leaves(_: float, state: np.ndarray) -> float:
        return state[0]

    leaves.terminal, leaves.direction = True, -1
    contact = hertz(impulse, speed, radius, stone)
    end = 3 * contact.time
    run = solve_ivp(motion, (0, end), [0, speed], events=leaves, rtol=1e-9, atol=1e-14, max_step=end / 3000)
    assert contact.time == pytest.approx(run.t[-1], rel=1e-3)
    assert contact.radius == pytest.approx(np.sqrt(radius * run.y[0].max()), rel=1e-4)


def test_hertz_scaling_laws() -> None:
    glass = material("glass")
    plain = hertz(10.0, 2.0, 0.1, glass)
    # m and v enter as m^(2/5) v^(-1/5); with m = I / v as I^(2/5) v^(-3/5).
    assert hertz(320.0, 2.0, 0.1, glass).time == pytest.approx(4 * plain.time)
    assert hertz(10.0, 64.0, 0.1, glass).time == pytest.approx(plain.time / 8)
    assert hertz(10.0, 2.0, 3.2, glass).time == pytest.approx(plain.time / 2)


@pytest.mark.parametrize("tilt", [0.0, 0.5])
@pytest.mark.parametrize("frequency", [4, 9])
def test_force_is_exact_and_acts_at_the_contact(tilt: float, frequency: int) -> None:
    impact, stone = _impact(tilt=tilt), material("stone")
    mesh = icosphere(frequency)
    areas = np.linalg.norm(mesh.area_vectors, axis=1)[:, None]
    force = tractions(impact, stone, mesh) * areas
    exact = contacts(impact, stone)[0].force * impact.direction[0]
    assert force.sum(axis=0) == pytest.approx(exact, rel=1e-12, abs=1e-9 * np.abs(exact).max())
    share = np.linalg.norm(force, axis=1)
    middle = share @ mesh.triangles.mean(axis=1) / share.sum()
    assert np.linalg.norm(middle - impact.position[0]) < 0.4 / frequency  # a third of an element


def test_resolved_patch_has_the_hertz_profile() -> None:
    """On a mesh finer than the patch the pressure is 1.5 F / (π a^2) sqrt(1 - (r / a)^2)."""
    impact = Impact([[0.0, 0, 1]], [[0.0, 0, -1]], [4e6], [[0.0, 0, 1]], speed=30.0, radius=1.0)
    stone = material("stone")
    contact = contacts(impact, stone)[0]
    mesh = box((2, 2, 2), (60, 60, 2))
    assert contact.radius > 5 * 2 / 60
    pressure = -tractions(impact, stone, mesh)[:, 2]
    centres = mesh.triangles.mean(axis=1)
    top = centres[:, 2] > 0.999
    inside2 = 1 - (np.linalg.norm(centres[:, :2], axis=1) / contact.radius) ** 2
    exact = 1.5 * contact.force / (np.pi * contact.radius**2) * np.sqrt(np.maximum(inside2, 0))
    assert np.abs(pressure - exact)[top & (inside2 > 0.3)].max() < 0.03 * exact.max()
    assert not pressure[~top].any()
