"""The slow-motion example: a glaze without a seam, a strip that shows the clay, pieces that fit, refusals."""

from __future__ import annotations

import io
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deepfracture.render.camera import frame_points
from deepfracture.render.renderer import RecordingRenderer
from deepfracture.types import BadInput, Recording

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture(autouse=True)
def where_it_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    """The program is imported from its folder, as when it is run."""
    monkeypatch.syspath_prepend(str(EXAMPLES))


def test_the_glaze_has_no_seam_and_follows_its_seed() -> None:
    painted_glaze = import_module("04_slow_motion").painted_glaze
    glaze = painted_glaze(np.random.default_rng(1))
    assert glaze == painted_glaze(np.random.default_rng(1)) != painted_glaze(np.random.default_rng(2))
    rows = np.asarray(Image.open(io.BytesIO(glaze)))
    differ = (rows[:, 0] != rows[:, -1]).any(axis=1).mean()
    assert differ < 0.02 < (rows[:, 0] != rows[:, rows.shape[1] // 14 // 2]).any(axis=1).mean()


def test_the_strip_shows_clay_only_once_the_pot_is_open(tmp_path: Path) -> None:
    example = import_module("04_slow_motion")
    example.slow_motion(tmp_path, seconds=0.12, pictures=13, size=(64, 48), still=(90, 100))
    assert (tmp_path / "slow_motion.mp4").stat().st_size > 1000
    strip = np.asarray(Image.open(tmp_path / "slow_motion.png")).astype(int)
    assert strip.shape == (100, 4 * 90 + 3 * example.GAP, 3)
    whole, *_, falling = (strip[:, k * (90 + example.GAP) : k * (90 + example.GAP) + 90] for k in range(4))
    assert clay(whole) < 40 < 200 < clay(falling)


def test_pieces_put_together_look_like_the_whole_pot() -> None:
    example = import_module("04_slow_motion")
    shape = example.glazed(np.random.default_rng(0))
    tracks = example.broken(shape, 0, 22.0, 0.08, 6).tracks
    (whole,) = (track for track in tracks if track.kind == "shape")
    still = {"start": 0, "positions": whole.positions[:1], "quats_wxyz": whole.quats_wxyz[:1], "rigid": None}
    pieces = [replace(track, **still) for track in tracks if track.kind == "fragment"]
    assert len(pieces) > 5
    points = shape.mesh.vertices + whole.positions[0]
    for azimuth in (-120.0, 60.0):
        camera = frame_points(points, 1.0, azimuth=azimuth)
        one, many = (
            RecordingRenderer(Recording(0.1, tuple(bodies)), camera, size=(160, 160), samples=2).picture(0).astype(int)
            for bodies in ([replace(whole, **still)], pieces)
        )
        assert np.ptp(one) > 150
        assert np.abs(one - many).max() <= 16


def clay(picture: np.ndarray) -> int:
    """Pixels that are clearly redder than blue and neither glaze nor ochre."""
    red, green, blue = np.moveaxis(picture, -1, 0)
    return int(((red - blue > 25) & (red - green > 15) & (red - blue < 90)).sum())


@pytest.mark.parametrize(("name", "value"), [("seconds", 0.01), ("pictures", 1), ("speed", 0.05)])
def test_what_shows_no_break_is_refused(tmp_path: Path, name: str, value: float) -> None:
    slow_motion = import_module("04_slow_motion").slow_motion
    with pytest.raises(BadInput, match=name):
        slow_motion(tmp_path, **{"seconds": 0.1, "pictures": 6, name: value})  # pyright: ignore[reportArgumentType]
