"""A soak repeats any hit from one number, survives kills and hangs, and notices what is wrong."""

from __future__ import annotations

import json
import os
import shlex
import signal
import threading
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture.cli import main
from deepfracture.soak import SoakOptions, case, first_cases, soak, summary
from deepfracture.soak.hit import PreparedHit, ShapesAndBreakers, TimedBreaker, hit, prepare
from deepfracture.soak.plan import SHARES, ready
from deepfracture.soak.results import FILE, MEMORY_GROWTH, WARM_UP, growth, sound
from deepfracture.types import BadInput, Fragment, Fragments, Mesh
from deepfracture.world.floor_penetration import PENETRATION_SLOP

DATA = Path(__file__).parents[4] / "shared" / "data"
FAST = SoakOptions(("bar", "letter_a"), ("voronoi",), seed=5, resolution=32)
PASSING = {"seconds", "break_seconds", "processor_seconds", "resident_mb", "worker", "number"}
"""What is not the same when a hit is repeated."""


def lasting(row):
    return {key: value for key, value in row.items() if key not in PASSING}


@pytest.fixture(scope="module")
def soaked(tmp_path_factory):
    """A soak whose process is killed after its first hit, and its folder."""
    out = tmp_path_factory.mktemp("soak") / "new"
    killed = []

    def kill():
        while not killed:
            time.sleep(0.01)
            lines = (out / FILE).read_text().splitlines() if (out / FILE).exists() else []
            if len(lines) > 1:
                killed.append(json.loads(lines[1])["worker"])
                os.kill(killed[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    rows = soak(FAST, 5, out=out)
    killer.join()
    return rows, out, killed[0]


def test_every_prefix_is_balanced_over_breakers_and_shapes():
    options = SoakOptions(breakers=("learned", "voronoi", "cvd", "physical"))
    shapes = ready(options)
    total = sum(SHARES[name] for name in shapes)
    assert set(shapes["learned"]) < set(shapes["voronoi"]) == set(options.shapes)
    cases = list(first_cases(options, 300))
    assert [one.number for one in cases] == list(range(300)) and case(options, 123) == cases[123]
    for n in (20, 77, 300):
        for name in shapes:
            own = [one.shape for one in cases[:n] if one.breaker == name]
            assert abs(len(own) - n * SHARES[name] / total) <= 1
            counts = Counter(own)
            assert max(counts.values()) - min(counts[shape] for shape in shapes[name]) <= 1


def test_a_killed_process_costs_its_hit_and_no_other(soaked):
    rows, _, killed = soaked
    assert [row["number"] for row in rows] == list(range(5))
    bad = [row for row in rows if row["failures"]]
    assert [list(row["failures"]) for row in bad] == [["died"]] and "SIGKILL" in bad[0]["detail"]
    assert {row["worker"] for row in rows if row["number"] > bad[0]["number"]} != {killed}
    assert all(row["fragments"] >= 2 for row in rows if row.get("breaks"))
    assert any(row.get("breaks") for row in rows)


def test_the_line_that_it_gives_repeats_a_hit(soaked, tmp_path):
    rows, _, _ = soaked
    row = next(row for row in rows if row.get("breaks") and row["number"] > 0)
    words = shlex.split(case(FAST, row["number"]).command(FAST))
    assert words[:2] == ["deepfracture", "soak"]
    main([*words[1:], "--out", str(tmp_path)])
    again = [json.loads(line) for line in (tmp_path / FILE).read_text().splitlines()][1:]
    assert [lasting(one) for one in again] == [lasting(row)]
    assert "No hit failed." in (tmp_path / "summary.md").read_text()


def test_it_goes_on_where_it_was_cut_short(soaked, tmp_path):
    rows, out, _ = soaked
    lines = (out / FILE).read_text().splitlines(keepends=True)
    (tmp_path / FILE).write_text("".join(lines[:5]) + lines[5][:40])  # a torn line, as a power cut leaves it
    began = (tmp_path / FILE).read_bytes()
    more = soak(FAST, 5, out=tmp_path)
    assert (tmp_path / FILE).read_bytes().startswith(began[:-40])
    assert [row["number"] for row in more] == list(range(5)) and more[:4] == rows[:4]
    assert lasting(more[4]) == lasting(rows[4]) or rows[4]["failures"]
    for other, word in ((replace(FAST, seed=6), "seed"), (replace(FAST, shapes=("bar",)), "shapes")):
        with pytest.raises(BadInput, match=f"made with {word} .*give another folder"):
            soak(other, 5, out=tmp_path)
    (tmp_path / FILE).write_text("something else\n")
    with pytest.raises(BadInput, match="not the results of a soak"):
        soak(FAST, 5, out=tmp_path)


def test_what_takes_too_long_is_a_failure_that_says_where_it_was(tmp_path):
    with pytest.raises(SystemExit, match="1"):
        main(["soak", "pot", "--breakers", "voronoi", "--hits", "1", "--limit", "0.5", "--out", str(tmp_path)])
    row = json.loads((tmp_path / FILE).read_text().splitlines()[-1])
    assert row["failures"] == {"limit": 1} and "hit.py" in row["traceback"]
    assert "`deepfracture soak pot --breakers voronoi --seed 0 --hits 1`" in (tmp_path / "summary.md").read_text()


@pytest.fixture(scope="module")
def resources():
    return ShapesAndBreakers(FAST)


def broken(resources, number, breaker=None):
    """A hit that may be spoilt."""
    begun = prepare(resources, case(FAST, number))
    return PreparedHit(begun.case, begun.scene, begun.shape, TimedBreaker(breaker or begun.breaker.breaker))


@pytest.fixture(scope="module")
def number(resources):
    """Of a hit over a floor that breaks something."""
    for k in range(40):
        ready = prepare(resources, case(FAST, k))
        if ready.scene.floor is not None and hit(ready).get("breaks"):
            return k
    raise LookupError


def test_an_open_fragment_and_a_lost_one_are_noticed(resources, number):
    usual = resources.breaker(case(FAST, number), resources.material(case(FAST, number), np.random.default_rng(0)))

    def torn(shape, impact, rng):
        found = usual(shape, impact, rng)
        if found is None:
            return None
        first, *rest = found
        mesh = Mesh(first.mesh.vertices, first.mesh.faces[1:])
        return Fragments((Fragment(mesh, first.source[1:], first.mass, first.centre, first.inertia), *rest))

    def lost(shape, impact, rng):
        found = usual(shape, impact, rng)
        return found and Fragments(found.pieces[1:])

    shape = case(FAST, number).shape
    assert hit(broken(resources, number))["failures"] == {}
    assert hit(broken(resources, number, torn))["failures"]["torn"] >= 1
    row = hit(broken(resources, number, lost))
    assert row["failures"]["volume"] >= 1 and row["volume_error"] > 1e-3 and row["shape"] == shape


def test_what_falls_through_the_floor_or_out_of_the_world_is_noticed(resources, number, monkeypatch):
    from deepfracture.world import Live
    from deepfracture.world.recorder import Recorder

    make = Recorder.recording

    def sunk(self):
        found = make(self)
        low = [
            replace(t, positions=t.positions - [0, 0, 3.0]) if t.kind == "fragment" else t for t in found.tracks
        ]  # fmt: skip
        return replace(found, tracks=tuple(low))

    with monkeypatch.context() as patch:
        patch.setattr(Recorder, "recording", sunk)
        row = hit(broken(resources, number))
        assert row["failures"]["through floor"] >= 2 and row["deepest"] > 1 and "centre of mass at -" in row["detail"]
    where = Live.at

    def nowhere(self, frame):
        return [pose._replace(position=pose.position * np.nan) if frame > 3 else pose for pose in where(self, frame)]

    monkeypatch.setattr(Live, "at", nowhere)
    row = hit(broken(resources, number))
    assert row["failures"] == {"pose": 1} and "frame 4" in row["detail"]


def test_a_crash_is_a_row_with_its_traceback(resources, number):
    def crash(shape, impact, rng):
        raise ZeroDivisionError("of a kind")

    row = hit(broken(resources, number, crash))
    assert row["failures"] == {"crash": 1} and row["detail"] == "ZeroDivisionError: of a kind"
    assert "in crash" in row["traceback"]


def test_growing_memory_is_noticed_once_a_process_is_warm():
    def rows(sizes):
        base = {"shape": "bar", "breaker": "voronoi", "resolution": 32, "failures": {}, "seconds": 1.0, "worker": 7}
        return [base | {"number": k, "seed": k, "resident_mb": size} for k, size in enumerate(sizes)]

    warm = [100.0 + 5 * k for k in range(WARM_UP)]
    flat, steep = rows([*warm, *[600.0] * 200]), rows([*warm, *(600 + np.arange(200.0))])
    assert growth(rows(warm)) is None and growth(flat) == 0 and growth(steep) == pytest.approx(150, abs=2)
    assert sound(flat) and not sound(steep) and MEMORY_GROWTH < 150
    assert "+150 MB" in summary(steep, FAST)
    late = rows([*warm, *[600.0] * 100, *[800.0] * 200])
    late[200]["shape"] = "letter_a"  # met for the first time: what is kept for it is no growth
    assert growth(late) == 0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"breakers": ("fysical",)}, "did you mean 'physical'"),
        ({"shapes": ("bar",), "breakers": ("learned",)}, "ready for none of bar; give --model"),
        ({"breakers": ("nearest",)}, "give --data"),
        ({"shapes": ("poot",)}, "did you mean 'pot'"),
        ({"resolution": 50}, "resolution must be one of"),
    ],
)
def test_what_cannot_be_soaked_is_refused_in_one_line(wrong, said):
    with pytest.raises(BadInput, match=said):
        soak(SoakOptions(**wrong), 1)


@pytest.mark.parametrize(
    ("shape", "breaker", "seed"),
    [
        ("bar", "cvd", 349),  # a ball of 142 kg at 59 m/s, splinters of 5 kg under it: 74 mm
        ("bowl", "cvd", 142),  # the same under 836 kg: 85 mm
        ("plate", "voronoi", 1062),  # a splinter of 0.4 kg born under the ball: 46 mm
        ("base", "voronoi", 2255),  # 79 mm
        ("bunny", "learned", 2534),  # a thin shard that lies flat: 7 mm, its centre of mass below the floor
        ("letter_a", "voronoi", 3554),  # a small piece of a piece: 26 mm
        (DATA / "cheburashka.obj", "voronoi", 5537),  # a flake 1 mm thick, its centre of mass below the floor
    ],
)
def test_what_is_pressed_into_the_floor_does_not_sink_in(shape, breaker, seed):
    """All that a soak of thousands of hits found, by how deep it was then."""
    if isinstance(shape, Path) and not shape.exists():
        pytest.skip("the shared meshes are not here")
    options = SoakOptions((str(shape),), (breaker,), seed=seed)
    row = hit(prepare(ShapesAndBreakers(options), case(options, 0)))
    assert row["breaks"] and not row["failures"]
    assert row["deepest"] < 1.01 * PENETRATION_SLOP


def test_a_contact_that_gives_no_momentum_is_no_blow():
    """Rapier told of a contact of 57 N s between two pieces in flight, neither of which it had slowed."""
    options = SoakOptions(("bunny",), ("learned",), seed=10221)
    row = hit(prepare(ShapesAndBreakers(options), case(options, 0)))
    assert row["breaks"] and not row["failures"]
