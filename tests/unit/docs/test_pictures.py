"""The programs that make the pictures of the documentation, with small settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import deepfracture as df

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def beside_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """The programs find their helpers where they lie, as when they are run."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))


def test_the_gallery_shows_every_plate_once(tmp_path: Path) -> None:
    from gallery import PLATES, gallery

    page = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert len({plate.name for plate in PLATES}) == len(PLATES)
    assert all(f"images/gallery/{plate.name}.jpg" in page for plate in PLATES)
    assert {path.stem for path in (ROOT / "docs/images/gallery").iterdir()} == {plate.name for plate in PLATES}
    (path,) = gallery(("bar-concrete",), size=(96, 72), resolution=32, data=tmp_path, out=tmp_path)
    with Image.open(path) as picture:
        assert picture.size == (96, 72)
        assert np.ptp(np.asarray(picture.convert("L"))) > 60
    before = path.stat().st_mtime_ns
    assert gallery(("bar-concrete",), data=tmp_path, out=tmp_path) == [path]
    assert path.stat().st_mtime_ns == before
    assert gallery(("squirrel",), data=tmp_path, out=tmp_path) == []  # its mesh is not there
    with pytest.raises(df.BadInput, match="no plate has this"):
        gallery(("no such",), out=tmp_path)


def test_a_plate_that_holds_is_told_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import gallery as program

    monkeypatch.setattr(program, "draw", lambda *_: False)  # nothing breaks
    with pytest.raises(df.BadInput, match="give the plate a faster ball"):
        program.gallery(out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_figures_are_drawn_and_known_to_the_page(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    from figures import FIGURES, figures

    page = (ROOT / "docs" / "explanation" / "how_it_works.md").read_text(encoding="utf-8")
    assert all(f"images/how/{name}.png" in page for name in FIGURES)
    for path in figures(("learned", "impulses"), resolution=32, dpi=40, view=(60, 50), out=tmp_path):
        with Image.open(path) as picture:
            assert np.ptp(np.asarray(picture.convert("L"))) > 100
    with pytest.raises(df.BadInput, match="no such figure"):
        figures(("leraned",), out=tmp_path)


def test_the_physical_figure_shows_a_tension_that_breaks() -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    from figures import physical

    figure = physical(df.load("pot"), 32, (60, 50))
    tension = np.asarray(figure.axes[0].images[0].get_array())
    assert np.nanmax(tension) > 1  # else nothing would have cracked
    labels = np.asarray(figure.axes[1].images[0].get_array())
    assert len(np.unique(labels[labels > 0])) > 2
    field = np.asarray(figure.axes[2].images[0].get_array())
    assert field.min() < -0.1 < 0.05 < field.max()
