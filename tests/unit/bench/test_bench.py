"""The benchmark's rows say what was measured; how long it took is nobody's promise."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

import pytest

from deepfracture.bench import BENCHES, Row, bench, comparison, keep, last, stamp, table
from deepfracture.bench.rows import share
from deepfracture.geometry import load_shape
from deepfracture.learn import embedded_model
from deepfracture.types import BadInput

FIELDS = {"stage", "shape", "resolution", "seconds", "peak_mb", "reference", "reference_seconds"}


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.setattr("deepfracture.bench.fracture.HITS", 2)
        patch.setattr("deepfracture.bench.fracture.RUNS", 1)
        return bench("all", load_shape("bar"), 32)


def test_rows_have_all_fields_and_measure_something(rows: list[Row]) -> None:
    for row in rows:
        assert set(asdict(row)) == FIELDS
        assert row.shape and row.seconds > 0 and row.peak_mb > 1
        assert bool(row.reference) == (row.reference_seconds is not None)
    assert len({(row.stage, row.shape) for row in rows}) == len(rows)


def test_every_room_and_the_stages_of_a_hit_are_there(rows: list[Row]) -> None:
    stages = [row.stage for row in rows]
    wanted = {
        "set-up, nothing cached",
        "set-up, cached",
        "hit",
        "hit, strongest",
        "hit / elastostatics",
        "hit / cracks",
    }
    assert wanted | {"encode", "segment", "cut", "load", "predict", "step"} <= set(stages)
    assert any(stage.startswith("add ") for stage in stages)
    assert {row.reference_seconds for row in rows if row.stage == "hit"} == {35.0}


def test_carving_stands_beside_the_usual_way_on_the_same_field(rows: list[Row]) -> None:
    pytest.importorskip("skimage", reason="scikit-image is not installed")
    stages = [row.stage for row in rows]
    assert {"reference / segment", "reference / surfaces", "reference / cut"} <= set(stages)
    assert sum(stage.startswith("reference, ") and " fragments" in stage for stage in stages) == 1
    parts = [row.seconds for row in rows if row.stage.startswith("reference / ")]
    (whole,) = (row.seconds for row in rows if row.stage.startswith("reference, "))
    assert whole <= 1.5 * sum(parts)


def test_without_its_library_the_usual_way_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("deepfracture.bench.carve.installed", lambda: False)
    rows = bench("carve", load_shape("bar"), 32)
    assert not any(row.stage.startswith("reference") for row in rows)
    (line,) = (record.getMessage() for record in caplog.records if "scikit-image" in record.getMessage())
    assert "pip install 'deepfracture[bench]'" in line


def test_with_a_model_the_whole_way_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deepfracture.bench.carve.installed", lambda: False)
    monkeypatch.setattr("deepfracture.bench.carve.HITS", 1)
    stages = [row.stage for row in bench("carve", load_shape("pot"), 32)]
    assert {"predict", "prepare, once a shape", "encode", "segment", "cut"} <= set(stages)
    assert any(stage.startswith("whole, ") for stage in stages)


def test_a_model_of_another_shape_is_refused() -> None:
    with pytest.raises(BadInput, match=r"trained on pot, not on bar"):
        bench("carve", load_shape("bar"), 32, embedded_model("pot"))


def test_an_uncached_set_up_does_more_than_a_cached_one(rows: list[Row]) -> None:
    parts = {row.stage for row in rows if row.stage.startswith("set-up / ")}
    assert {"set-up / remesh", "set-up / boundary elements", "set-up / distances"} <= parts


def test_shares_are_those_of_the_stage_around() -> None:
    whole = Row("hit", "bar", 32, 2.0, 1.0)
    part = Row("hit / cracks", "bar", 32, 0.5, 1.0)
    assert share(part, [whole, part]) == 0.25
    assert share(whole, [whole, part]) is None
    assert share(Row("hit / cracks", "pot", 32, 0.5, 1.0), [whole, part]) is None
    assert share(Row("cut / cells", "bar", 32, 0.5, 1.0), [Row("cut", "bar", 32, 1.0, 1.0), whole]) == 0.5
    assert share(Row("cut / cells", "bar", 32, 0.5, 1.0), [whole]) is None


def test_the_table_has_a_line_a_row(rows: list[Row]) -> None:
    lines = table(rows).splitlines()
    assert len(lines) == len(rows) + 1
    for row, line in zip(rows, lines[1:], strict=True):
        assert line.startswith(row.stage) and row.shape in line


def test_unknown_rooms_are_refused() -> None:
    with pytest.raises(BadInput, match=f"choose one of {', '.join(BENCHES)} or all"):
        bench("kitchen", load_shape("bar"), 32)


def test_the_command_writes_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from deepfracture.cli.bench import bench as command

    row = Row("hit", "bar", 32, 2.0, 1.0)
    monkeypatch.setattr("deepfracture.bench.BENCHES", {"fracture": lambda shape, resolution, model: [row]})
    command("fracture", shape="bar", resolution=32, json_file=tmp_path / "new" / "rows.json")
    assert json.loads((tmp_path / "new" / "rows.json").read_text()) == [asdict(row)]
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["rows.json"]


def test_kept_measurements_say_where_and_when_and_the_next_ones_compare(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from deepfracture.cli.bench import bench as command

    caplog.set_level("INFO", logger="deepfracture")
    seconds = iter((2.0, 3.0, 1.0))
    monkeypatch.setattr(
        "deepfracture.bench.BENCHES",
        {"fracture": lambda shape, resolution, model: [Row("hit", "bar", 32, next(seconds), 1.0)]},
    )
    days = iter(("2030-01-01T00:00:00+00:00", "2030-01-02T00:00:00+00:00", "2030-01-03T00:00:00+00:00"))
    made = stamp()
    monkeypatch.setattr("deepfracture.bench.stamp", lambda: made | {"date": next(days)})

    def told() -> str:
        caplog.clear()
        command("fracture", shape="bar", resolution=32, json_file=None, record=tmp_path / "kept")
        return caplog.text

    assert "no earlier measurement on such a machine" in told()
    slower, quicker = told(), told()
    assert "    2.0000    3.0000    1.50 !" in slower and "2030-01-01" in slower
    assert "    3.0000    1.0000    0.33 +" in quicker and "2030-01-02" in quicker  # with the last, not the first
    held = [json.loads(file.read_text()) for file in sorted((tmp_path / "kept").iterdir())]
    assert [one["rows"][0]["seconds"] for one in held] == [2.0, 3.0, 1.0]
    assert set(held[0]["machine"]) == {
        "date", "deepfracture", "processor", "cores", "system", "python", "libraries", "load",
    }  # fmt: skip
    assert held[0]["machine"]["cores"] == os.cpu_count() and held[0]["machine"]["libraries"]["numpy"]


def test_measurements_of_another_machine_are_left_alone_and_other_files_complained_of(tmp_path: Path) -> None:
    made = stamp()
    keep([Row("hit", "bar", 32, 2.0, 1.0)], tmp_path, made | {"cores": 4096})
    assert last(tmp_path, made) is None
    keep([Row("hit", "bar", 32, 2.0, 1.0)], tmp_path, made | {"date": "2030-01-01T00:00:00+00:00"})
    known = last(tmp_path, made)
    assert known is not None and comparison([Row("cut", "bar", 32, 1.0, 1.0)], known).endswith("no stage in common")
    (tmp_path / "bench-x.json").write_text("{}")
    with pytest.raises(BadInput, match=r"bench-x\.json: not a measurement"):
        last(tmp_path, made)
