"""What Blender makes of our files, and the add-on inside it.

Both need a Python that can `import bpy`, in an environment of its own, for Blender pins its own NumPy:
DEEPFRACTURE_BLENDER names it.
"""

from __future__ import annotations

import json
import os
import runpy
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ROOT / "tests" / "tools"
BLENDER = os.environ.get("DEEPFRACTURE_BLENDER")
recordings = runpy.run_path(str(TOOLS / "recordings.py"))
needs_blender = pytest.mark.skipif(
    BLENDER is None, reason="DEEPFRACTURE_BLENDER does not name a Python that can import bpy (pip install bpy==5.0.1)"
)


@pytest.fixture
def agreement(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return __import__("blender_agreement")


UPS = {
    "z": np.eye(4),
    "y": np.array([[100, 0, 0, 5], [0, 0, 100, 6], [0, -100, 0, 7], [0, 0, 0, 1]], float) * [0.02, 0.02, 0.02, 1],
    "x": np.array([[0, 0, 1, 5], [0, 1, 0, 6], [-1, 0, 0, 7], [0, 0, 0, 1]], float),
}


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("up", UPS)
def test_blender_sees_every_fragment_where_it_was_recorded(agreement, up, tmp_path):
    recording = recordings["broken_octahedron"](UPS[up])
    formats = ("glb", "usdc", "abc", "fbx") if up == "z" else ("glb", "usdc")
    rows = agreement.agreement(recording, tmp_path, BLENDER, formats)
    assert [row.format for row in rows] == list(formats)
    for row in rows:
        assert (row.fragments, row.frames) == (2, 5)
        assert row.ok and row.deviation < 1e-4, row


@needs_blender
@pytest.mark.slow
def test_the_comparison_can_fail(agreement, tmp_path):
    recording = recordings["broken_octahedron"]()
    shifted = np.eye(4)
    shifted[0, 3] = 2e-4
    agreement.agreement(recordings["broken_octahedron"](shifted), tmp_path, BLENDER, ("glb",))
    with np.load(tmp_path / "glb.npz") as seen:
        row = agreement.compared(recording, "glb", dict(seen), [20, 30, 40, 50, 60])
    assert not row.ok and row.deviation == pytest.approx(2e-4, abs=1e-5)


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What tests/tools/blender_addon.py found after it installed the add-on and broke a slab with it."""
    folder = tmp_path_factory.mktemp("addon")
    archive = folder / "deepfracture.zip"
    with zipfile.ZipFile(archive, "w") as package:
        for file in sorted((ROOT / "blender" / "deepfracture").iterdir()):
            if file.is_file():
                package.write(file, file.name)
    program = folder / "deepfracture"
    program.write_text(f"#!/bin/sh\nexec {sys.executable} -c 'from deepfracture.cli import main; main()' \"$@\"\n")
    program.chmod(0o755)
    (folder / "user").mkdir()
    command = [BLENDER, TOOLS / "blender_addon.py", archive, program, folder / "said.json", folder / "user"]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    shutil.rmtree(folder / "user")
    return json.loads((folder / "said.json").read_text())


@needs_blender
@pytest.mark.slow
def test_the_addon_breaks_an_object_into_closed_pieces(said):
    facts, pieces = said["facts"], said["facts"]["pieces"]
    assert said["result"] == ["FINISHED"] and len(pieces) > 5
    assert all(piece["closed"] for piece in pieces)
    assert sum(piece["volume"] for piece in pieces) == pytest.approx(facts["whole_volume"], rel=1e-5)


@needs_blender
@pytest.mark.slow
def test_its_materials_and_uvs_stay_outside_and_a_second_material_is_inside(said):
    for piece in said["facts"]["pieces"]:
        assert piece["materials"] == ["Clay", "Glaze", "deepfracture inner"]
        assert 2 in piece["slots"] and piece["uv_layer"] == "Atlas"
        assert piece["uv_known"] == 1.0 and piece["uv_error"] < 1e-4
    assert {slot for piece in said["facts"]["pieces"] for slot in piece["slots"]} == {0, 1, 2}


@needs_blender
@pytest.mark.slow
def test_pieces_have_keys_and_rigid_bodies_and_take_the_place_of_the_whole(said):
    facts, pieces = said["facts"], said["facts"]["pieces"]
    assert facts["whole_hidden"] and not facts["before"]["whole_hidden"]
    assert all(facts["before"]["pieces_hidden"]) and not any(piece["hidden"] for piece in pieces)
    for piece in pieces:
        frames = {piece["keys"][f"location {k}"] for k in range(3)}
        frames |= {piece["keys"][f"rotation_quaternion {k}"] for k in range(4)}
        assert len(frames) == 1 and frames.pop() > 10
        assert piece["keys"]["hide_render 0"] == 2
        assert (piece["type"], piece["kinematic"], piece["shape"]) == ("ACTIVE", True, "CONVEX_HULL")
    masses = np.array([piece["mass"] for piece in pieces])
    volumes = np.array([piece["volume"] for piece in pieces])
    assert masses / volumes == pytest.approx(np.full(len(pieces), masses.sum() / volumes.sum()), rel=1e-3)
    assert max(piece["moved"] for piece in pieces) > 0.2


@needs_blender
@pytest.mark.slow
def test_undo_takes_it_back(said):
    assert said["objects_undone"] == said["objects_before"] == ["Slab", "Slab impact"]
    assert said["hidden_undone"] is False


@needs_blender
@pytest.mark.slow
def test_released_pieces_come_to_lie_on_the_floor(said):
    assert said["again"] == ["FINISHED"]
    heights = np.array(said["heights"])
    assert heights.min() > -0.05 and np.median(np.abs(heights)) < 0.02


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "says"),
    [
        ("without_arrow", "there is no arrow"),
        ("without_program", "name the deepfracture program in the add-on's preferences"),
        ("past", "the arrow points past the object"),
        ("soft", "did not break: try a faster or larger ball"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(said, case, says):
    assert says in said[case] and "\n" not in said[case]


def test_the_manifest_is_that_of_this_version():
    manifest = (ROOT / "blender" / "deepfracture" / "blender_manifest.toml").read_text()
    version = (ROOT / "pyproject.toml").read_text().split('version = "')[1].split('"')[0]
    assert f'version = "{version}"' in manifest and 'license = ["SPDX:MIT"]' in manifest
