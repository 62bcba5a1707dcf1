"""Meshes that nobody should send: some of each class of `benchmarks/hostile_meshes.py`, which has them all."""

from __future__ import annotations

import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from deepfracture.geometry import check_solid, load_shape, mesh_defects, normalise
from deepfracture.geometry.repair import repair
from deepfracture.geometry.untangle import self_intersecting_faces, untangle
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Mesh

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
try:
    from hostile_files import files
    from hostile_meshes import FAILED, Outcome, break_both, cases, guarded, verdict
    from hostile_solids import ball, joined, solids, torus, tube
finally:
    sys.path.remove(str(BENCHMARKS))

WRITERS = {f"{kind}: {name}": write for kind, name, write in cases()}
BROKEN = (
    "flipped: letter_a, half of the faces turned",
    "nested shells: hollow ball",
    "OBJ files: negative indices",
    "OBJ files: mtllib outside the folder",
    "OBJ files: a hundred thousand materials",
)
MENDED = ("open: mug, one face missing", "crosses itself: two cubes")
REFUSED = {
    "open: sheet": "1 open shell",
    "open: Moebius strip": "1 open shell",
    "zero-area faces: mug squeezed to a plane": "",
    "NaN and infinite: one coordinate NaN": "NaN",
    "odd units: mug, 1e300 long": "scale it down",
    "odd units: mug, 1e-300 long": "scale it up",
    "few faces: face of a vertex that is not there": "",
    "many bodies: 2 cubes in a row": "2 separate",
    "OBJ files: index of twenty digits": "line",
    "PLY files: ascii, a billion vertices": "",
    "PLY files: binary, a billion vertices": "",
    "PLY files: binary, 1e18 vertices": "",
    "PLY files: binary, a billion faces": "",
    "STL files: binary, four billion faces": "",
    "OFF files: a billion vertices": "",
    "GLB and GLTF files: count of four billion": "",
    "GLB and GLTF files: count of 1e18": "",
    "GLB and GLTF files: count of four billion without a view": "at most",
    "GLB and GLTF files: sparse accessor of four billion": "at most",
    "GLB and GLTF files: tree longer than the file": "",
    "GLB and GLTF files: buffer in a file outside the folder": "",
    "GLB and GLTF files: buffer of a device": "",
    "GLB and GLTF files: nodes in a ring": "",
    "mis-named and foreign files: STL called .glb": "",
    "mis-named and foreign files: nothing called .obj": "empty",
}
"""What the reason must say, of meshes that not even repair makes a solid of."""
MUCH = 200 << 20
"""Bytes that no refusal may need."""


def test_there_are_two_hundred_of_them_all_with_names_of_their_own() -> None:
    assert len(list(solids())) + len(list(files())) == len(WRITERS) >= 200


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_but_odd_breaks_correctly(case: str, tmp_path: Path) -> None:
    plain, _ = break_both(WRITERS[case](tmp_path))
    assert plain.kind == "broken", plain.note


@pytest.mark.parametrize("case", MENDED)
def test_what_is_damaged_breaks_correctly_once_mended(case: str, tmp_path: Path) -> None:
    plain, mended = break_both(WRITERS[case](tmp_path))
    assert (plain.kind, mended.kind) == ("refused", "broken"), (plain.note, mended.note)
    assert "--repair" in plain.note


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_solid_is_refused_in_one_line_and_little_memory(case: str, tmp_path: Path) -> None:
    path = WRITERS[case](tmp_path)
    for mend in (False, True):
        tracemalloc.start()
        with pytest.raises(BadInput) as caught:
            load_shape(str(path), repair=mend)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        message = str(caught.value)
        assert "\n" not in message and path.name in message
        assert mend or REFUSED[case] in message
        assert most < MUCH


def test_a_surface_that_runs_through_itself_is_told_of_and_mended(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    angle = np.arange(60) / 60 * 2 * np.pi
    eight = Mesh(*tube(np.stack([np.sin(angle), np.sin(2 * angle) / 2, 0.02 * np.cos(angle)], -1), 0.12))
    assert mesh_defects(eight).closed and len(self_intersecting_faces(eight))
    path = tmp_path / "eight.obj"
    rows = ["v {} {} {}\n".format(*p) for p in eight.vertices] + ["f {} {} {}\n".format(*f) for f in eight.faces + 1]
    path.write_text("".join(rows))
    log.addHandler(caplog.handler)
    try:
        load_shape(str(path))  # its faces look inward, which is mended without a word
        assert "runs through itself" in caplog.text and "--repair" in caplog.text
        caplog.clear()
        mended = load_shape(str(path), repair=True)
    finally:
        log.removeHandler(caplog.handler)
    assert not len(self_intersecting_faces(mended.mesh)) and mesh_defects(mended.mesh).closed
    # Where the tube passes through itself it counts once.
    assert 0.9 * abs(eight.volume) < mended.mesh.volume * mended.scale**3 < abs(eight.volume)


def test_small_tangles_are_smoothed_and_all_else_stays() -> None:
    vertices, faces = ball(4)
    tangle = np.linalg.norm(vertices - [0, 0, 1], axis=1) < 0.15
    rough = vertices + tangle[:, None] * np.random.default_rng(1).normal(size=vertices.shape) * 0.045
    mesh = Mesh(rough, faces)
    assert len(self_intersecting_faces(mesh))
    smooth, count = untangle(mesh, np.zeros(len(faces), np.int64)) or (mesh, 0)
    assert count and not len(self_intersecting_faces(smooth))
    far = np.linalg.norm(vertices - [0, 0, 1], axis=1) > 0.4
    np.testing.assert_array_equal(smooth.vertices[far], mesh.vertices[far])


def test_shells_that_overlap_are_united_although_faces_cross() -> None:
    rings = joined(torus(1, 0.2), (torus(1, 0.2)[0] + [0.9, 0, 0], torus(1, 0.2)[1]))
    solid = repair(Mesh(*rings), "rings")
    assert mesh_defects(solid).closed and mesh_defects(solid).shells == 1 and not len(self_intersecting_faces(solid))
    assert check_solid(solid, "rings").volume < 2 * Mesh(*torus(1, 0.2)).volume
    assert normalise(solid, "rings").mesh.bounds.max() == pytest.approx(1)


def test_verdicts() -> None:
    broken, refused, failed = Outcome("broken", ""), Outcome("refused", ""), Outcome(FAILED, "")
    assert verdict(broken, broken) == "broken"
    assert verdict(refused, broken) == "repaired, then broken"
    assert verdict(refused, refused) == "refused"
    assert verdict(broken, failed) == verdict(failed, broken) == FAILED


def test_what_crashes_hangs_or_takes_too_much_is_found_out() -> None:
    import os
    import signal

    def crash():
        os.kill(os.getpid(), signal.SIGKILL)
        yield

    def hang():
        yield Outcome("broken", "")
        while True:
            pass

    def greed():
        np.ones(1 << 33)
        yield Outcome("broken", "")

    assert [outcome.kind for outcome in guarded(crash, seconds=5)] == [FAILED, FAILED]
    plain, mended = guarded(hang, seconds=1)
    assert plain.kind == "broken" and "longer than 1 s" in mended.note
    assert "MemoryError" in guarded(greed, seconds=5)[0].note
