"""The numbered examples, with small settings: each does what it says, makes its picture, and refuses nonsense."""

from __future__ import annotations

import csv
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import deepfracture as df
from deepfracture.geometry import mesh_defects, read_triangles

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture(autouse=True)
def where_they_lie(monkeypatch: pytest.MonkeyPatch) -> None:
    """The programs find their helpers where they lie, as when they are run."""
    monkeypatch.syspath_prepend(str(EXAMPLES))


def shows_something(path: Path) -> bool:
    """A picture that is not one colour."""
    with Image.open(path) as picture:
        return bool(np.ptp(np.asarray(picture.convert("L"))) > 60)


def test_numbers_run_without_a_gap_and_every_example_is_told_of() -> None:
    numbered = sorted(path.name for path in EXAMPLES.glob("[0-9]*.py"))
    assert [name[:2] for name in numbered] == [f"{k:02d}" for k in range(1, len(numbered) + 1)]
    page = (EXAMPLES.parent / "docs" / "guide" / "examples.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in page for name in (*numbered, "film.py"))


def test_01_pieces_fill_the_pot_and_the_world_moves(tmp_path: Path) -> None:
    import_module("01_break_a_pot").break_a_pot(tmp_path)
    pieces = [read_triangles(path) for path in (tmp_path / "pieces").glob("*.ply")]
    whole = df.load("pot")
    assert len(pieces) > 3
    assert sum(piece.volume for piece in pieces) == pytest.approx(whole.mesh.volume * whole.scale**3, rel=1e-5)
    assert shows_something(tmp_path / "pieces.png") and shows_something(tmp_path / "pot.png")
    assert (tmp_path / "pot.glb").stat().st_size > 10_000
    with pytest.raises(df.BadInput, match="nothing broke"):
        import_module("01_break_a_pot").break_a_pot(tmp_path, impulse=0.01)


def test_02_a_damaged_scan_comes_back_in_its_millimetres(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    example = import_module("02_your_own_mesh")
    with caplog.at_level("INFO"):
        example.your_own_mesh(out=tmp_path, breaker="voronoi", resolution=32)
    assert "boundary edges" in caplog.text and "opposite orientation" in caplog.text
    scan = read_triangles(tmp_path / "scan.obj")
    assert not mesh_defects(scan).closed
    pieces = [read_triangles(path) for path in (tmp_path / "pieces").glob("*.ply")]
    assert len(pieces) > 1 and all(mesh_defects(piece).closed for piece in pieces)
    corners = np.concatenate([piece.bounds for piece in pieces])
    assert corners.min(axis=0) == pytest.approx(scan.bounds[0], abs=0.2)
    assert corners.max(axis=0) == pytest.approx(scan.bounds[1], abs=0.2)
    assert shows_something(tmp_path / "animation.png")
    with pytest.raises(df.BadInput, match="no such file"):
        example.your_own_mesh(tmp_path / "other.obj", out=tmp_path)


def test_03_breakers_stand_side_by_side(tmp_path: Path) -> None:
    example = import_module("03_compare_breakers")
    example.compare_breakers("bar", breakers=("cvd", "voronoi"), out=tmp_path, resolution=32, size=(96, 80))
    with Image.open(tmp_path / "breakers.png") as sheet:
        assert sheet.size == (2 * 96 + 4, 80 + 24)
    assert shows_something(tmp_path / "breakers.png")
    with pytest.raises(df.BadInput, match="raise --impulse"):
        example.compare_breakers("bar", breakers=("voronoi",), out=tmp_path, impulse=1e-3, resolution=32)


def test_05_trains_and_says_what_it_was_worth(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed")
    import_module("05_train_your_own").train_your_own(
        "bar", out=tmp_path, collisions=5, held=3, speed=(18, 30), minutes=0.01, resolution=32, workers=1, size=(64, 48)
    )
    table = (tmp_path / "evaluation" / "evaluation.md").read_text(encoding="utf-8")
    assert all(name in table for name in ("learned", "nearest", "random", "voronoi"))
    assert (tmp_path / "run" / "model.safetensors").stat().st_size > 100_000
    assert shows_something(tmp_path / "held_out.png")


def test_06_the_web_has_rays_and_rings_and_falls_apart(tmp_path: Path) -> None:
    example = import_module("06_write_a_breaker")
    plate = df.load("plate")
    blow = df.hit(plate, (0.1, 0.2, 2), (0, 0, -1), impulse=1000, speed=40)
    web = example.SpiderWeb(df.Grid(32), rays=8, rings=(0.4,))
    pattern = web(plate, blow, np.random.default_rng(0))
    assert pattern.count == 16
    inner = pattern.labels[(np.hypot(*(pattern.grid.centres()[..., :2] - blow.position[0, :2]).T) < 0.3).T]
    assert inner.max() <= 8  # the sectors within the ring come first
    assert (pattern.labels == web(plate, blow, np.random.default_rng(0)).labels).all()
    example.write_a_breaker(tmp_path, resolution=32, size=(96, 80))
    assert len(list((tmp_path / "pieces").glob("*.ply"))) > 20
    assert shows_something(tmp_path / "pieces.png") and shows_something(tmp_path / "plate.png")


def test_07_harder_shots_break_more(tmp_path: Path) -> None:
    example = import_module("07_many_shots_statistics")
    example.many_shots("pot", shots=14, out=tmp_path)
    rows = list(csv.DictReader((tmp_path / "shots.csv").open()))
    assert len(rows) == 14
    impulses, counts = (np.array([float(row[name]) for row in rows]) for name in ("impulse_Ns", "fragments"))
    assert np.corrcoef(impulses, counts)[0, 1] > 0.5
    assert shows_something(tmp_path / "shots.png")
    with pytest.raises(df.BadInput, match="shots must be at least 2"):
        example.many_shots("bar", shots=1, out=tmp_path)


def test_08_the_loop_goes_on_while_it_breaks(tmp_path: Path) -> None:
    example = import_module("08_game_loop")
    shots = example.game_loop(tmp_path, shots=2, realtime=False)
    for shot in shots:
        assert shot.fragments > 1 and shot.frames > 0
        assert 0 < sum(shot.milliseconds[name] for name in example.STAGES) <= shot.milliseconds["all"]
    assert len((tmp_path / "times.txt").read_text(encoding="utf-8").splitlines()) == 3
    assert shows_something(tmp_path / "times.png")


def test_the_film_joins_its_shots(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    example = import_module("film")
    assert sum(shot.seconds for shot in example.SHOTS) == pytest.approx(20)
    count = example.film(tmp_path, size=(96, 64), samples=1, shots=1, length=0.05)
    assert count == round(0.05 * example.SHOTS[0].seconds * 30)
    assert (tmp_path / "film.mp4").stat().st_size > 500
    (still,) = (tmp_path / "stills").iterdir()
    assert shows_something(still)
    with pytest.raises(df.BadInput, match="shots must be"):
        example.film(tmp_path, shots=0)


def test_what_is_cut_out_of_a_recording_keeps_its_poses() -> None:
    example = import_module("film")
    pot = df.load("pot")
    recording = df.throw(pot, df.breaker("voronoi", pot, resolution=32), speed=10).recording
    part = example.cut_out(recording, 20, 60)
    assert part.frames == 40
    for track in part.tracks:
        (source,) = (one for one in recording.tracks if one.name == track.name)
        there = 20 + track.start - source.start
        assert np.array_equal(track.positions, source.positions[there : there + len(track.positions)])


def test_a_bad_value_ends_an_example_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    from starting import start  # pyright: ignore[reportMissingImports]

    monkeypatch.setattr("sys.argv", ["07_many_shots_statistics.py", "--shots", "0"])
    with pytest.raises(SystemExit) as stopped:
        start(import_module("07_many_shots_statistics").many_shots)
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("07_many_shots_statistics.py: shots must be at least 2")
