"""The written reference is that of the code, and what the pages name in the code exists."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
RECORDS = ("CHANGELOG.md", "profiles.md")
"""Pages that name what was, at their time."""


@pytest.fixture(autouse=True)
def scripts_of_the_documentation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.setenv("NO_COLOR", "1")


def test_the_python_reference_is_up_to_date() -> None:
    pytest.importorskip("griffe", reason="pip install '.[docs]' first")
    from make_reference import api

    page = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    assert page == api(), "run python docs/make_reference.py"


def test_the_command_line_reference_has_every_command_and_option() -> None:
    pytest.importorskip("griffe", reason="pip install '.[docs]' first")
    from make_reference import command_line

    page = (ROOT / "docs" / "reference" / "cli.md").read_text(encoding="utf-8")
    headings_and_arguments = re.compile(r"^(?:## .+|\| `.+?` )", re.M)
    found, written = (headings_and_arguments.findall(text) for text in (command_line(), page))
    assert len(found) > 80
    assert written == found, "run python docs/make_reference.py"


def test_the_map_is_drawn_from_the_imports() -> None:
    from make_map import PICTURE, circles, draw, file_graph, room_graph

    rooms = room_graph(file_graph())
    assert circles(rooms) == []
    assert PICTURE.read_text(encoding="utf-8") == draw(rooms), "run python docs/make_map.py"


def test_the_table_of_rooms_is_that_of_the_arrows() -> None:
    from tests.unit.test_architecture import ARROWS

    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text(encoding="utf-8")
    table = dict(re.findall(r"^\| `(\w+)/` \| .+ \| (.*?) ?\|$", page, re.M))
    assert table.pop("cli") == "all"
    assert {room: {*filter(None, arrows.split(", "))} for room, arrows in table.items()} == ARROWS


def test_the_scene_keys_are_those_of_the_format() -> None:
    from dataclasses import fields

    from deepfracture.world import Ball, Block, Floor, Placed, Scene

    page = (ROOT / "docs" / "reference" / "scene_format.md").read_text(encoding="utf-8")
    tables = [set(re.findall(r"^\| `(\w+)` \|", part, re.M)) for part in page.split("\n## ")[1:]]
    assert tables == [
        {field.metadata.get("key", field.name) for field in fields(cls)} for cls in (Scene, Placed, Ball, Block, Floor)
    ]


@pytest.mark.parametrize("page", [pytest.param(page, id=str(page.relative_to(ROOT))) for page in PAGES])
def test_files_and_names_of_the_code_exist(page: Path) -> None:
    if page.name in RECORDS:
        return
    text = page.read_text(encoding="utf-8")
    files = {path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py") if ".venv" not in path.parts}
    for name in re.findall(r"`([\w/]+\.py)\b[^`]*`", text):
        assert any(f"/{file}".endswith(f"/{name}") for file in files), f"{page.name}: there is no {name}"
    for name in re.findall(r"`deepfracture((?:\.\w+)+)[`(]", text):
        module, _, attribute = f"deepfracture{name}".rpartition(".")
        found = importlib.import_module(module)
        if not hasattr(found, attribute):
            importlib.import_module(f"deepfracture{name}")


def test_the_places_of_the_glossary_exist() -> None:
    page = (ROOT / "docs" / "reference" / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| .+ \| (`[^|]+`) \|$", page, re.M)
    assert len(rows) > 60
    for place in (place for row in rows for place in re.findall(r"`(.+?)`", row)):
        if place.endswith(".py"):
            assert (ROOT / "src" / "deepfracture" / place).is_file(), f"there is no {place}"
            continue
        module, _, name = f"deepfracture.{place}".rpartition(".")
        if not hasattr(importlib.import_module(module), name):
            importlib.import_module(f"deepfracture.{place}")
