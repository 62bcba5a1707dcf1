"""The documentation: it builds strictly, what it links to and shows is there, and its Python is true."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import textwrap
from importlib.util import find_spec
from pathlib import Path

import pytest

import deepfracture as df

ROOT = Path(__file__).parents[3]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
NAMED = [pytest.param(page, id=str(page.relative_to(ROOT))) for page in PAGES]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
BLOCK = re.compile(r"^```python\n(.*?)^```", re.M | re.S)
MOST_BYTES = 12_000_000
"""Of all pictures together: a clone stays small."""


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def anchors(page: Path) -> set[str]:
    """What headings of a page are called in links."""
    heads = re.findall(r"^#+ (.+)$", text_of(page), re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", NAMED)
def test_links_and_pictures_are_there(page: Path) -> None:
    for link in LINK.findall(re.sub(r"```.*?```", "", text_of(page), flags=re.S)):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, anchor = link.partition("#")
        goal = (page.parent / name).resolve() if name else page
        assert goal.exists(), f"{page.name} links to {link}"
        assert goal.is_relative_to(ROOT), f"{page.name} links out of the repository: {link}"
        if anchor and goal.suffix == ".md":
            assert anchor in anchors(goal), f"{page.name} links to {link}, a heading that is not there"


def test_every_page_can_be_reached() -> None:
    nav = text_of(ROOT / "mkdocs.yml")
    links = {page.parent / link.partition("#")[0] for page in PAGES for link in LINK.findall(text_of(page))}
    linked = {link.resolve() for link in links}
    for page in (ROOT / "docs").rglob("*.md"):
        assert str(page.relative_to(ROOT / "docs")) in nav or page in linked, f"{page.name}: no way leads to it"


def test_pictures_stay_small() -> None:
    assert sum(path.stat().st_size for path in (ROOT / "docs" / "images").rglob("*") if path.is_file()) < MOST_BYTES


@pytest.mark.parametrize("page", [p for p in NAMED if BLOCK.search(text_of(p.values[0]))])  # pyright: ignore
def test_python_on_a_page_is_python_and_its_names_exist(page: Path) -> None:
    for block in BLOCK.findall(text_of(page)):
        for node in ast.walk(ast.parse(textwrap.dedent(block))):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "df":
                assert hasattr(df, node.attr), f"{page.name}: deepfracture has no {node.attr}"
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("deepfracture"):
                module = __import__(node.module or "", fromlist=["_"])
                missing = [alias.name for alias in node.names if not hasattr(module, alias.name)]
                assert not missing, f"{page.name}: {node.module} has no {missing}"


def commands(page: Path) -> dict[str, set[str]]:
    """The options that a page uses, by command."""
    used: dict[str, set[str]] = {}
    text = text_of(page)
    code = re.findall(r"```.*?```", text, re.S) + re.findall(r"^(?: {4}|`).*$", text, re.M)
    for line in re.findall(r"^\s*(?:`|\$ )?deepfracture ([a-z].*)$", "\n".join(code), re.M):
        command, *rest = line.split("#")[0].split("`")[0].split()
        used.setdefault(command, set()).update(word for word in rest if word.startswith("--"))
    return used


def test_commands_on_the_pages_exist_with_their_options(capsys: pytest.CaptureFixture) -> None:
    from deepfracture.cli import main

    used: dict[str, set[str]] = {}
    for page in PAGES:
        for command, options in commands(page).items():
            used.setdefault(command, set()).update(options)
    assert {"shatter", "play", "simulate", "train", "evaluate", "info"} <= set(used)
    for command, options in used.items():
        with pytest.raises(SystemExit) as done:
            main([command, "--help"])
        text = capsys.readouterr().out
        assert done.value.code == 0, f"no command {command}"
        missing = [option for option in options if not re.search(rf"{option}\b", text)]
        assert not missing, f"{command} has no {missing}"


def test_the_ten_lines_run_and_are_the_same_everywhere(tmp_path: Path) -> None:
    block, same = (BLOCK.findall(text_of(page))[0] for page in (ROOT / "README.md", ROOT / "docs" / "index.md"))
    assert len([line for line in block.splitlines() if line.strip()]) <= 10
    assert ast.dump(ast.parse(block)) == ast.dump(ast.parse(same))
    subprocess.run([sys.executable, "-c", block], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert (tmp_path / "pot.glb").is_file()
    assert len(list((tmp_path / "pieces").glob("*.ply"))) > 3


def test_the_examples_of_docstrings_name_what_exists() -> None:
    from deepfracture import api

    shown = 0
    for name in df._HOMES["api"]:
        doc = getattr(api, name).__doc__
        assert "Examples:" in doc, f"{name} has no example"
        for line in re.findall(r">>> (.+)", doc):
            shown += 1
            for node in ast.walk(ast.parse(line)):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "df":
                    assert hasattr(df, node.attr), f"{name}: deepfracture has no {node.attr}"
    assert shown >= len(df._HOMES["api"])


@pytest.mark.skipif(not find_spec("mkdocs"), reason="pip install '.[docs]' first")
def test_the_site_builds_strictly_and_fetches_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", str(ROOT / "mkdocs.yml")]
    done = subprocess.run([*command, "--site-dir", str(tmp_path / "site")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 15
    for page in pages:
        for tag in re.findall(r"<(?:script|link|img)\b[^>]*>", page.read_text(encoding="utf-8")):
            source = re.search(r"(?:src|href)=\"?(https?:[^\"\s>]+)", tag)
            assert source is None or "canonical" in tag, f"{page.name} fetches {source and source[1]}"
    reference = (tmp_path / "site" / "reference" / "api.html").read_text(encoding="utf-8")
    assert all(f'id="df{name}"' in reference for name in df._HOMES["api"])
