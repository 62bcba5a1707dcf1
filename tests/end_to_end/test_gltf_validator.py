"""The Khronos validator finds nothing to complain about in our GLB."""

import json
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest

from deepfracture.export import write_glb

TOOLS = Path(__file__).parents[1] / "tools"
tools = runpy.run_path(str(TOOLS / "recordings.py"))


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
