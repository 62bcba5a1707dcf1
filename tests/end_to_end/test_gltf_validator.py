"""The Khronos validator finds nothing to complain about in our GLB."""

import io
import json
import runpy
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deepfracture.export import write_glb

TOOLS = Path(__file__).parents[1] / "tools"
tools = runpy.run_path(str(TOOLS / "recordings.py"))
painted = runpy.run_path(str(TOOLS / "painted.py"))


def validate(path: Path) -> dict:
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node on PATH (Debian: apt-get install nodejs npm)")
    if not (TOOLS / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("gltf-validator is not installed (npm install --prefix tests/tools)")
    done = subprocess.run(
        [node, str(TOOLS / "validate_gltf.js"), str(path)], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def test_no_errors_and_no_warnings(tmp_path):
    write_glb(tools["broken_octahedron"](), tmp_path / "a.glb")
    report = validate(tmp_path / "a.glb")
    issues = report["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
    assert report["info"]["animationCount"] == 1


def test_the_validator_does_find_errors(tmp_path):
    write_glb(tools["broken_octahedron"](), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes().replace(b'"VEC4"', b'"VEC2"')
    (tmp_path / "a.glb").write_bytes(data)
    assert validate(tmp_path / "a.glb")["issues"]["numErrors"] > 0


@pytest.mark.parametrize("picture", ["PNG", "JPEG"])
def test_none_with_textures_colours_and_materials_either(tmp_path, picture):
    shape, fragments = painted["broken_cube"](tmp_path)
    data = io.BytesIO()
    Image.new("RGB", (13, 7), (9, 90, 200)).save(data, format=picture)
    colours = np.random.default_rng(1).integers(0, 256, (12, 3, 4))
    glaze, wax = shape.appearance.finishes
    look = replace(shape.appearance, colours=colours, finishes=(replace(glaze, texture=data.getvalue()), wax))
    write_glb(painted["filmed"](replace(shape, appearance=look), fragments), tmp_path / "a.glb")
    report = validate(tmp_path / "a.glb")
    issues = report["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
    assert {m["code"] for m in issues["messages"]} <= {"UNUSED_OBJECT", "IMAGE_NPOT_DIMENSIONS"}
    assert report["info"]["materialCount"] == 3 and report["info"]["hasTextures"]
    assert report["info"]["maxUVs"] == 1
