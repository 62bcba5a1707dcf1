"""Hertz's scaling laws and how a load is spread; its closed forms are cases of `deepfracture.validation`."""

from __future__ import annotations

import numpy as np
import pytest

from deepfracture.fracture.contact import contacts, hertz, tractions
from deepfracture.fracture.materials import material
from deepfracture.types import Impact
from deepfracture.validation.meshes import box, icosphere


def _impact(magnitude: float = 300.0, *, tilt: float = 0.0) -> Impact:
    direction = np.array([[np.sin(tilt), 0, -np.cos(tilt)]])
    return Impact([[0.0, 0, 1]], direction, [magnitude], [[0.0, 0, 1]], speed=8.0, radius=0.1)


def test_hertz_scaling_laws() -> None:
    glass = material("glass")
    plain = hertz(10.0, 2.0, 0.1, glass)
    # m and v enter as m^(2/5) v^(-1/5); with m = I / v as I^(2/5) v^(-3/5).
    assert hertz(320.0, 2.0, 0.1, glass).duration == pytest.approx(4 * plain.duration)
    assert hertz(10.0, 64.0, 0.1, glass).duration == pytest.approx(plain.duration / 8)
    assert hertz(10.0, 2.0, 3.2, glass).duration == pytest.approx(plain.duration / 2)


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
