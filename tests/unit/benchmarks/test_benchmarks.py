"""The benchmark programs: each one's core on the bar, and that its checks can fail."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from deepfracture.carve import cut
from deepfracture.dataset import CollisionResult, Local, SimulateOptions, simulate_collisions
from deepfracture.fracture import material
from deepfracture.geometry import builtin, mesh_defects, signed_distance
from deepfracture.types import BadInput, FracturePattern, Fragment, Fragments, Grid, Impact, Mesh, Shape

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
PLASTER = material("plaster")


@pytest.fixture(autouse=True)
def beside_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """The programs find their helpers where they lie, as when they are run."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))


def halves() -> FracturePattern:
    """The bar parted at x = 0."""
    grid = Grid(32)
    x = grid.centres()[..., 0]
    inside = signed_distance(builtin("bar").mesh, grid) > 0
    labels = np.where(inside, np.where(x < 0, 1, 2), 0)
    return FracturePattern(grid, labels.astype(np.int32), np.abs(x).astype(np.float32))


def test_contact_sheet_draws_every_hit_once(tmp_path: Path) -> None:
    from contact_sheet import CAPTION, MOST_BYTES, contact_sheet
    from PIL import Image

    def draw() -> Path:
        return contact_sheet(
            ("bar", "no_such_shape"), hits=2, resolution=32, size=(96, 72), data=tmp_path, reference=tmp_path,
            out=tmp_path / "kept", sheet=tmp_path / "sheet.png",
        )  # fmt: skip

    sheet = draw()
    assert Image.open(sheet).size == (2 * 96, 72 + CAPTION)
    assert sheet.stat().st_size < MOST_BYTES
    about = [json.loads(path.read_text()) for path in sorted((tmp_path / "kept").glob("*.json"))]
    assert len(about) == 2
    assert about[0]["speed"] < about[1]["speed"]
    assert sum(about[0]["volumes"]) == pytest.approx(builtin("bar").mesh.volume, rel=1e-3)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").iterdir()}
    draw()
    assert before == {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").iterdir()}


def test_hit_checks_run_a_case_and_resume(tmp_path: Path) -> None:
    from hit_checks import run_case, summary

    run_case("bar", tmp_path, 1, 32, "plaster", (4.0, 25.0), 0, tmp_path)
    first = (tmp_path / "bar" / "000.json").read_text()
    run_case("bar", tmp_path, 2, 32, "plaster", (4.0, 25.0), 0, tmp_path)
    rows = [json.loads((tmp_path / "bar" / f"{n:03d}.json").read_text()) for n in range(2)]
    assert (tmp_path / "bar" / "000.json").read_text() == first
    assert [row["failures"] for row in rows] == [[], []]
    assert max(row["fragments"] for row in rows) > 1
    case = {"body": {"faces": 1100}, "exit": 0, "hits": rows}
    assert "No failure" in summary({"bar": case}, 2)
    assert "only 2 of 3 hits" in summary({"bar": case}, 3)


def test_hit_checks_refuse_an_open_mesh_in_one_line(tmp_path: Path) -> None:
    from hit_checks import run_case

    data = tmp_path / "data"
    data.mkdir()
    data.joinpath("sheet.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    run_case("sheet", tmp_path, 1, 32, "plaster", (4.0, 25.0), 0, data)
    body = json.loads((tmp_path / "sheet" / "body.json").read_text())
    assert body["refused"].startswith("sheet.obj: ")
    assert "\n" not in body["refused"]


def test_hit_checks_see_what_is_wrong() -> None:
    from hit_checks import fragment_failures, pattern_failures

    shape, pattern = builtin("bar"), halves()
    inside = signed_distance(shape.mesh, pattern.grid)
    pieces = cut(shape, pattern, density=1.0)
    assert pattern_failures(pattern, inside) == []
    assert fragment_failures(shape, pattern, pieces) == []
    swapped = FracturePattern(pattern.grid, np.where(inside > 0, 0, 3), pattern.distance)
    wrong = " ".join(pattern_failures(swapped, inside))
    assert all(text in wrong for text in ("without a label", "outside", "empty labels", "one label"))
    first = pieces.pieces[0]
    torn = Fragment(Mesh(first.mesh.vertices, first.mesh.faces[1:]), first.source[1:], 1.0, first.centre, first.inertia)
    wrong = " ".join(fragment_failures(shape, pattern, Fragments((torn,))))
    assert all(text in wrong for text in ("volumes off", "not closed", "leak", "one piece"))


@pytest.mark.parametrize("name", ["zero_area", "slivers", "thin_legs"])
def test_degenerate_meshes_are_closed_and_degenerate(name: str) -> None:
    from degenerate import DEGENERATE, LEG, TOUCHED

    mesh = DEGENERATE[name]().mesh
    assert mesh_defects(mesh).closed
    heights = 2 * np.linalg.norm(mesh.area_vectors, axis=1) / np.linalg.norm(np.ptp(mesh.triangles, axis=1), axis=1)
    if name == "thin_legs":
        assert np.ptp(mesh.vertices[mesh.vertices[:, 2] < 0][:, 0]) == pytest.approx(1.0)
        assert mesh.volume == pytest.approx(0.2 + 4 * 1.8 * LEG**2)
    else:
        assert (heights < 1e-5).sum() >= TOUCHED


def collide(settings):
    """Hits on the end of the bar break it into slabs: the stronger, the more and the thinner."""
    inside = signed_distance(settings.shape.mesh, Grid(settings.resolution)) > 0

    def one(rng: np.random.Generator, again: np.random.Generator | None = None) -> CollisionResult:
        strength = int(rng.integers(1, 9))
        impact = Impact([[-1.0, 0, 0]], [[1.0, 0, 0]], [100.0 * strength], [[-1.0, 0, 0]], speed=1.0, radius=0.2)
        x = np.arange(settings.resolution)[:, None, None]
        labels = np.where(inside, x * 2 * strength // settings.resolution + 1, 0)
        pattern = FracturePattern(Grid(settings.resolution), labels, np.zeros(labels.shape))
        return CollisionResult(impact, pattern if strength > 1 else None)

    return one


def test_statistics_find_what_rises_with_the_impulse(tmp_path: Path) -> None:
    from collision_statistics import collision_statistics

    simulate_collisions(
        builtin("bar"), PLASTER, tmp_path / "set",
        SimulateOptions(collisions=12, resolution=32, seed=1, speed=(1.0, 2.0)),
        executor=Local(1), make_simulator=collide,
    )  # fmt: skip
    collision_statistics(datasets=(tmp_path / "set",), small=0.9, reference=tmp_path, docs=tmp_path)
    about = json.loads((tmp_path / "reports" / "statistics.json").read_text())["shapes"]["bar"]
    assert about["collisions"] == 12
    assert about["broke"] < 12
    assert about["fragments"][0] == 1
    assert about["count_rises"]["rho"] == pytest.approx(1, abs=1e-9)
    assert about["count_rises"]["low"] <= about["count_rises"]["rho"] <= about["count_rises"]["high"]
    assert about["small_rises"]["rho"] > 0.6
    assert about["shattered_rises"]["rho"] > 0.6
    assert (tmp_path / "images" / "statistics" / "bar.png").stat().st_size > 5000
    assert "| bar | 12 |" in (tmp_path / "reports" / "statistics.md").read_text()


def test_mott_distance_knows_motts_own_distribution() -> None:
    from collision_statistics import mott_distance, mott_larger

    # u = (6 x)^(1/3) is exponential with mean 1
    quantiles = -np.log1p(-(np.arange(20000) + 0.5) / 20000)
    assert mott_distance([quantiles**3]) < 0.01
    assert mott_distance([np.ones(50)]) == pytest.approx(1 - mott_larger(np.ones(1))[0])


def test_rank_correlation_of_a_constant_is_zero() -> None:
    from collision_statistics import rank_correlation

    x = np.arange(10.0)
    assert rank_correlation(x, np.ones(10), np.random.default_rng(0)).rho == 0
    falling = rank_correlation(x, -(x**3), np.random.default_rng(0))
    assert (falling.rho, falling.low, falling.high) == pytest.approx((-1, -1, -1))


def test_hits_depend_on_seed_and_number_alone() -> None:
    from harness import throw

    shape: Shape = builtin("bar")
    one, same, other = (throw(shape, PLASTER, n, seed=3, speed=(5.0, 6.0)) for n in (4, 4, 5))
    assert one.impact.magnitude == same.impact.magnitude
    assert one.rng.random() == same.rng.random()
    assert (one.impact.position != other.impact.position).any()
    assert 0 < one.impact.speed < 6.1


def test_round_trip_compares_the_ways_and_skips_what_is_absent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from round_trip import round_trip

    simulate_collisions(
        builtin("bar"), PLASTER, tmp_path / "set",
        SimulateOptions(collisions=4, resolution=32, seed=1, speed=(1.0, 2.0)),
        executor=Local(1), make_simulator=collide,
    )  # fmt: skip
    page = round_trip((tmp_path / "set",), patterns=2, data=tmp_path, reference=tmp_path, out=tmp_path / "out")
    lines = [line.split("|")[1:-1] for line in page.read_text().splitlines() if "simulated" in line]
    assert [line[2].strip() for line in lines] == ["the paper's flood", "our flood", "with cuts"]
    assert lines[2][3] == lines[2][4]
    assert float(lines[2][6]) == 0.0
    assert any("squirrel" in record.getMessage() for record in caplog.records)
    with pytest.raises(BadInput, match="none given"):
        round_trip((), out=tmp_path)


def test_cracks_between_labels_lie_on_the_smooth_surface() -> None:
    from round_trip import cracks_of, filled, halved

    grid = Grid(32)
    away = np.linalg.norm(grid.centres(), axis=-1)
    labels = np.where(away < 0.6, 2, 1).astype(np.int32)
    points, normals = cracks_of(labels, grid)
    radii = np.linalg.norm(points, axis=1)
    assert abs(radii - 0.6).max() < 0.5 * grid.spacing  # the voxels themselves are off by as much again
    assert abs(abs((normals * points).sum(axis=1) / radii)).min() > 0.95
    hollow = np.where(abs(away - 0.6) < 0.05, 0, labels).astype(np.int32)
    assert (filled(hollow) != labels).mean() < 0.02
    assert set(np.unique(halved(labels))) == {1, 2}
    assert halved(labels).shape == (16, 16, 16)
