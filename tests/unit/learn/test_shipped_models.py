"""The models that ship: whole, small, of the shapes they are named after, and honest about themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepfracture.carve import segment
from deepfracture.geometry import builtin
from deepfracture.learn import embedded_model, load_partition_model
from deepfracture.learn.loading import MODELS
from deepfracture.types import Impact

NAMES = sorted(path.stem for path in MODELS.glob("*.safetensors"))


def test_the_promised_models_ship() -> None:
    assert NAMES == ["base", "bunny", "mug", "pot"]


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_model_knows_its_shape_and_breaks_it(name: str) -> None:
    path = embedded_model(name)
    assert path is not None and path.stat().st_size < 8e6
    model, shape = load_partition_model(path), builtin(name)
    assert model.shape_name == name and model.matches_shape(shape)
    hardest = model.selector.impulses[model.selector.impulses[:, 0, 6].argmax(), 0].astype(float)
    hit = Impact(
        [hardest[:3]], [hardest[3:6] / np.linalg.norm(hardest[3:6])], [model.normaliser.max_impulse],
        [-hardest[3:6] / np.linalg.norm(hardest[3:6])], speed=10.0, radius=0.2,
    )  # fmt: skip
    found = [segment(model.predict(hit, np.random.default_rng(draw))).count for draw in range(3)]
    assert min(found) > 4


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_model_has_a_card_with_its_figures(name: str) -> None:
    card = Path(MODELS / f"{name}.txt").read_text()
    for words in ("deepfracture simulate", "deepfracture train", "seed", "memory", "| nearest |", "| learned |"):
        assert words in card
