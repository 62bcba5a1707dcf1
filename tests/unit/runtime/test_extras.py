"""Optional libraries: named in one line when they are missing, and what can be done without them is done."""

from __future__ import annotations

import ast
import logging
import re
import sys
from pathlib import Path

import pytest

from deepfracture.runtime import extras
from deepfracture.runtime.extras import is_installed, pip_command, require, skip_unless_installed
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[3]
SOURCE = ROOT / "src" / "deepfracture"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def declared(requirement: str) -> str:
    """The name to import of what a line of pyproject.toml asks for."""
    name = requirement.split(";")[0].split(">")[0].split("<")[0].strip()
    return {"usd-core": "pxr", "pillow": "PIL"}.get(name, name.replace("-", "_"))


OPTIONAL = {
    declared(line)
    for extra, lines in PROJECT["optional-dependencies"].items()
    if extra not in ("test", "docs", "all")
    for line in lines
    if not line.startswith("deepfracture[")
}
BASE = {declared(line) for line in PROJECT["dependencies"]}


def test_what_is_there_is_returned() -> None:
    assert require("json.decoder", extra="play", to="play").JSONDecodeError
    assert is_installed("json") and not is_installed("no_such_library") and not is_installed("no_such_library.part")


def test_what_is_missing_is_one_line_with_the_remedy() -> None:
    with pytest.raises(BadInput) as caught:
        require("no_such_library.part", extra="play", to="play in the browser")
    assert str(caught.value) == (
        "no_such_library is needed to play in the browser and is not installed: pip install 'deepfracture[play]'"
    )


def test_what_does_not_load_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "torn_library.py").write_text("raise ImportError('libGL.so.1: no such file\\nsecond line')")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(BadInput, match=r"fails to load \(libGL.so.1: no such file\)") as caught:
        require("torn_library", extra="render", to="draw")
    assert "\n" not in str(caught.value)


def test_a_file_is_left_out_with_one_line(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "deepfracture"):
        assert skip_unless_installed("film.mp4", "no_such_library", extra="render")
        assert not skip_unless_installed("film.mp4", "json", extra="render")
    assert caplog.messages == [
        "film.mp4 skipped: no_such_library is not installed (pip install 'deepfracture[render]')"
    ]


def test_every_extra_that_is_named_exists() -> None:
    known = set(PROJECT["optional-dependencies"])
    found = []
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                named = [word.value for word in node.keywords if word.arg == "extra"]
                if node.func.id == "pip_command":
                    named += node.args
                found += [(path.name, n.value) for n in named if isinstance(n, ast.Constant)]
    assert len(found) > 8
    assert [(file, extra) for file, extra in found if extra not in known] == []


def test_the_base_imports_no_optional_library_unasked() -> None:
    """Every import of an optional library is inside a function, or in a module that such an import leads to."""
    assert not OPTIONAL & BASE and {"torch", "zarr", "viser", "pxr", "onnx", "pybullet"} <= OPTIONAL
    for path in SOURCE.rglob("*.py"):
        if "TID253" in path.read_text() and path.parts[-2] in ("partition", "published", "learn"):
            continue  # the rooms of torch, which `learn.train` alone imports
        for node in ast.parse(path.read_text()).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not {name.split(".")[0] for name in names} & OPTIONAL, path


def test_shatter_without_viser_and_ffmpeg_leaves_two_files_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from deepfracture.cli import main

    there = extras.is_installed
    monkeypatch.setattr(
        extras, "is_installed", lambda module: module not in ("viser", "imageio_ffmpeg") and there(module)
    )
    main(["shatter", "bar", "--breaker", "voronoi", "--resolution", "32", "--speed", "16", "--out", str(tmp_path)])
    assert not (tmp_path / "animation.html").exists() and not (tmp_path / "animation.mp4").exists()
    assert (tmp_path / "animation.glb").stat().st_size > 1000 and (tmp_path / "picture.png").exists()
    assert "animation.html skipped: viser is not installed (pip install 'deepfracture[play]')" in caplog.messages
    assert (
        "animation.mp4 skipped: imageio_ffmpeg is not installed (pip install 'deepfracture[render]')" in caplog.messages
    )


def test_data_sets_without_zarr_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from deepfracture.dataset import open_dataset

    monkeypatch.setattr(extras, "is_installed", lambda module: module != "zarr")
    with pytest.raises(BadInput, match=r"zarr is needed .* pip install 'deepfracture\[data\]'"):
        open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("word", "said"), [("plastre", "; did you mean 'plaster'?"), ("GLASS", "; did you mean 'glass'?"), ("xyzzy", "")]
)
def test_the_nearest_word_is_offered(word: str, said: str) -> None:
    assert did_you_mean(word, ("glass", "plaster", "stone")) == said


def test_pip_line_names_all() -> None:
    assert pip_command("usd", "play") == "pip install 'deepfracture[usd,play]'"


def test_every_dependency_has_its_licence_told() -> None:
    told = (ROOT / "THIRD_PARTY.md").read_text().lower()
    lines = [*PROJECT["dependencies"], *(one for some in PROJECT["optional-dependencies"].values() for one in some)]
    names = {re.split(r"[<>=;\[ ]", line)[0] for line in lines} - {"deepfracture"}
    assert len(names) > 20 and [name for name in sorted(names) if name not in told] == []


def test_the_version_is_the_same_everywhere() -> None:
    import deepfracture

    version = PROJECT["version"]
    assert deepfracture.__version__ == version
    assert f"version: {version}" in (ROOT / "CITATION.cff").read_text()
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()
