"""The load of a collision and the gate before a fracture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from deepfracture.fracture.contact import breaks, contacts, critical_stress, element_area, hertz, tractions
from deepfracture.fracture.materials import material
from deepfracture.types import BadInput, Impact, Mesh

STONE = material("stone")
CORNERS = np.array([(x, y, z) for x in (-1.0, 1) for y in (-1.0, 1) for z in (-0.02, 0.02)])
PLATE_FACES = """0 1 3  0 3 2  4 6 7  4 7 5  0 4 5  0 5 1  2 3 7  2 7 6  0 2 6  0 6 4  1 5 7  1 7 3"""
PLATE = Mesh(CORNERS, np.array(PLATE_FACES.split(), int).reshape(-1, 3))


def _impact(*magnitudes: float, direction: tuple[float, float, float] = (0, 0, -1)) -> Impact:
    k = len(magnitudes)
    positions = [[0.5 - index, 0.2, 0.02] for index in range(k)]
    return Impact(positions, [direction] * k, magnitudes, [[0.0, 0, 1]] * k, speed=5.0, radius=0.1)


def _force(mesh: Mesh, traction: np.ndarray) -> np.ndarray:
    return (traction * np.linalg.norm(mesh.area_vectors, axis=1)[:, None]).sum(axis=0)


def test_contacts_add() -> None:
    one, two = _impact(90.0), _impact(90.0, 30.0)
    second = Impact(two.position[1:], two.direction[1:], [30.0], two.normal[1:], speed=5.0, radius=0.1)
    apart = tractions(one, STONE, PLATE) + tractions(second, STONE, PLATE)
    assert tractions(two, STONE, PLATE) == pytest.approx(apart)
    total = -sum(contact.force for contact in contacts(two, STONE))
    assert _force(PLATE, tractions(two, STONE, PLATE)) == pytest.approx([0, 0, total])


def test_far_side_of_a_thin_wall_stays_free() -> None:
    loaded = np.abs(tractions(_impact(50.0), STONE, PLATE)).sum(axis=1) > 0
    assert loaded.any()
    assert (PLATE.area_vectors[loaded, 2] > 0).all()


def test_wrong_normal_is_refused() -> None:
    inward = Mesh(PLATE.vertices, PLATE.faces[PLATE.area_vectors[:, 2] <= 1e-9])
    with pytest.raises(BadInput, match="normal"):
        tractions(_impact(50.0), STONE, inward)


def test_gate_is_the_papers_formula() -> None:
    impact = _impact(50.0)
    contact = contacts(impact, STONE)[0]
    wide, small = 12.0, 0.01
    assert critical_stress(impact, STONE, wide) == pytest.approx(50.0 / (wide / 1500 * contact.duration))
    patch = np.pi * contact.radius**2
    assert element_area(small) < patch
    assert critical_stress(impact, STONE, small) == pytest.approx(50.0 / (patch * contact.duration))


def test_gate_counts_only_what_presses() -> None:
    slanted = _impact(50.0, direction=(0.6, 0, -0.8))
    assert critical_stress(slanted, STONE, 12.0) == pytest.approx(0.8 * critical_stress(_impact(50.0), STONE, 12.0))
    assert critical_stress(_impact(50.0, direction=(0, 0, 1)), STONE, 12.0) == 0


def test_breaks_exactly_above_the_strength() -> None:
    impact = _impact(50.0)
    limit = critical_stress(impact, STONE, 12.0)
    assert breaks(impact, replace(STONE, strength=0.99 * limit), 12.0)
    assert not breaks(impact, replace(STONE, strength=1.01 * limit), 12.0)


def test_stronger_hits_load_more() -> None:
    stresses = [critical_stress(_impact(i), STONE, 12.0) for i in (1.0, 10.0, 100.0)]
    assert stresses == sorted(stresses)


@pytest.mark.parametrize("bad", [(0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 0.0)])
def test_bad_numbers_are_refused(bad: tuple[float, float, float]) -> None:
    with pytest.raises(BadInput, match="positive"):
        hertz(*bad, STONE)
    with pytest.raises(BadInput, match="surface_area"):
        critical_stress(_impact(50.0), STONE, 0.0)
