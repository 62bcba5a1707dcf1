"""The named materials."""

from __future__ import annotations

import pytest

from deepfracture.fracture.materials import MATERIALS, material
from deepfracture.types import BadInput


def test_names_lead_to_their_material() -> None:
    assert {"glass", "ceramic", "porcelain", "stone", "plaster", "concrete"} <= set(MATERIALS)
    for name in MATERIALS:
        assert material(name).name == name


def test_unknown_name_lists_those_that_exist() -> None:
    with pytest.raises(BadInput, match=r"cheese.*glass, ceramic") as error:
        material("cheese")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", MATERIALS)
def test_brittle_orders_of_magnitude(name: str) -> None:
    """Flaws that break it are finer than the body, coarser than atoms; sound outruns any collision."""
    preset = material(name)
    flaw = (preset.toughness / preset.strength) ** 2 / 3.14159
    assert 1e-5 < flaw < 0.1
    assert 500 < preset.rayleigh_speed < 4000
    assert preset.strength * preset.compressive_factor < preset.young / 10


def test_presets_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        MATERIALS["glass"] = material("stone")  # type: ignore[index]
