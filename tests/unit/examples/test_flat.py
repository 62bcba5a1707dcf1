"""The two-dimensional study of representations: its patterns, its readers, and that it repeats."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from deepfracture.compare import variation_of_information
from deepfracture.types import BadInput, Grid

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture(autouse=True)
def beside_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """The programs find their helpers where they lie, as when they are run."""
    monkeypatch.syspath_prepend(str(EXAMPLES))


def test_a_harder_hit_breaks_a_plate_into_more_pieces_each_in_one_part() -> None:
    from flat_plate import break_plate
    from scipy import ndimage

    rng = np.random.default_rng(0)
    soft, hard = (break_plate(np.array([0.1, -0.2, speed]), 64, rng) for speed in (0.2, 1.0))
    assert 4 < soft.labels.max() < hard.labels.max()
    for piece in range(1, hard.labels.max() + 1):
        assert ndimage.label(hard.labels == piece)[1] == 1
    same = break_plate(np.array([0.3, 0, 0.5]), 32, np.random.default_rng(5))
    assert (same.labels == break_plate(np.array([0.3, 0, 0.5]), 32, np.random.default_rng(5)).labels).all()


@pytest.mark.parametrize("way", ["labels", "labels by place", "lines", "USDF"])
def test_an_exact_image_is_read_back_nearly_exactly(way: str) -> None:
    from flat_plate import break_plate

    study = import_module("09_flat_study")
    readers, target = study.READERS, study.target

    rng = np.random.default_rng(1)
    plate = break_plate(np.array([0.0, 0.2, 0.4]), 64, rng)
    count = int(plate.labels.max())
    image = target(way, plate, count, rng)
    channels = (image[None] == np.arange(count)[:, None, None]) if way.startswith("labels") else image[None]
    found = readers[way](channels.astype(np.float32), 0.5 if way == "lines" else 0.1, Grid(64))
    assert variation_of_information(found, plate.labels) < 0.7
    assert found.max() == pytest.approx(count, abs=2)


def test_the_study_repeats_and_leaves_its_picture(tmp_path: Path) -> None:
    study = import_module("09_flat_study")
    ways, flat_study = study.WAYS, study.flat_study

    def run(name: str) -> dict:
        flat_study(tmp_path / name, resolution=32, train=16, held=5, steps=4, seeds=2, channels=4)
        return json.loads((tmp_path / name / "flat_study.json").read_text())

    first = run("a")
    assert first == run("b")
    assert set(ways) < set(first["summary"])
    assert (tmp_path / "a" / "flat_study.png").stat().st_size > 10_000
    with pytest.raises(BadInput, match="held"):
        flat_study(tmp_path, held=1)
