"""Write docs/reference/api.md and docs/reference/cli.md from the docstrings and the command line's help.

python docs/make_reference.py
"""

from __future__ import annotations

import contextlib
import io
import os
import re
from pathlib import Path
from typing import Any

import griffe

import deepfracture
from deepfracture.cli import main

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "reference"
SECTIONS = {
    "Functions": ("load", "breaker", "hit", "stress", "throw", "throw_scene", "run", "save", "simulate", "train"),
    "Values": (
        "Shape", "Mesh", "Material", "material", "Impact", "Breaker", "Fragments", "Fragment", "FracturePattern",
        "Volume", "Grid", "Recording",
    ),
    "Scenes": ("Scene", "Placed", "Ball", "Floor", "Block", "Outcome", "Live", "load_scene"),
    "Options": ("BreakerOptions", "SimulateOptions", "TrainOptions"),
    "Errors": ("BadInput", "NoSolution"),
}  # fmt: skip
"""Public names by heading; options and other classes that signatures name follow them."""
BESIDE = {
    "types": ("Track", "Rigid", "Appearance", "Finish"),
    "world": ("Collision",),
    "breakers.options": ("BreakerOptions",),
    "dataset.options": ("SimulateOptions",),
    "learn.options": ("TrainOptions",),
}
"""Classes that the public ones are made of, by module."""
API_HEAD = """# Python

*Written by `python docs/make_reference.py` from the docstrings.*

Everything that the command line does, in a few functions. `import deepfracture as df` is instant: each name is loaded
on first use. Every function raises [`BadInput`](#badinput), one line that says what is wrong and what to do. SI
everywhere; a shape lives in its body frame, two metres long.

| on the command line | in Python |
|---|---|
| `shatter SHAPE` | [`throw`](#dfthrow), then [`save`](#dfsave) |
| `shatter --scene FILE` | [`run`](#dfrun) of [`load_scene(FILE)`](#dfload_scene) |
| `play` | [`Live`](#live): a simulation that accepts balls while it runs |
| `simulate`, `train` | [`simulate`](#dfsimulate), [`train`](#dftrain) |
| `info` | the values themselves: `shape.mesh.bounds`, `len(data)`, `data.max_impulse` ... |
| `evaluate` | `deepfracture.evaluate.evaluate` |
| `validate` | `deepfracture.validation.run_cases` |
| `bench` | `deepfracture.bench.bench` |
| `export-onnx` | `deepfracture.learn.partition.onnx.export_onnx` of `deepfracture.learn.load_model(FILE)` |

The context manager `deepfracture.runtime.progress.collect_stages` collects the time of each stage. Messages go to the
logger `deepfracture`.
"""
CLI_HEAD = """# Command line

*Written by `python docs/make_reference.py` from `deepfracture COMMAND --help`.*

Exit status 0: done; 2: an invalid file or value; 1: a failure with valid ones, such as a full disk. Every command takes
`--quiet`, `--verbose` and `--profile FILE`.
"""


def api() -> str:
    """The reference of the Python interface as Markdown."""
    package = griffe.load("deepfracture", search_paths=[str(ROOT / "src")], docstring_parser="google")
    lines = [API_HEAD]
    for title, names in SECTIONS.items():
        lines += [f"## {title}\n", *(_entry(package[f"{deepfracture._HOME[name]}.{name}"]) for name in names)]
    beside = [package[f"{module}.{name}"] for module, names in BESIDE.items() for name in names]
    return "\n".join([*lines, "## Parts and options\n", *map(_entry, beside)]).rstrip() + "\n"


def command_line() -> str:
    """The reference of the command line as Markdown."""
    commands = re.findall(r"^    • ([\w-]+)", _help(), re.M)
    return "\n".join([CLI_HEAD, *(_command(name) for name in commands)]).rstrip() + "\n"


def _entry(thing: Any) -> str:
    """A function or a class: signature, docstring, fields and methods."""
    while thing.is_alias:
        thing = thing.final_target
    if thing.is_attribute:
        lines = [f"### {thing.name}\n", f"```python\n{thing.name} = {thing.value}\n```\n"]
    elif thing.is_function:
        lines = [f"### df.{thing.name}\n", f"```python\n{_signature(thing)}\n```\n"]
    else:
        bases = f"({', '.join(map(str, thing.bases))})" if thing.bases else ""
        lines = [f"### {thing.name}\n", f"```python\nclass {thing.name}{bases}: ...\n```\n"]
    lines.append(_docstring(thing))
    if thing.is_class:
        members = [m for m in thing.members.values() if not m.name.startswith("_") and not m.is_alias]
        fields = [m for m in members if m.is_attribute and "property" not in m.labels]
        lines += [_item(f"{m.name}: {m.annotation}" + (f" = {m.value}" if m.value else ""), m) for m in fields]
        lines += [_item(f"{m.name}: {m.annotation}", m) for m in members if "property" in m.labels]
        lines += ["", *(_method(m) for m in members if m.is_function)]
    return "\n".join(lines).rstrip() + "\n"


def _signature(function: Any) -> str:
    """`name(parameter: type = default) -> type`, a parameter a line where it is long."""
    parts: list[str] = []
    for parameter in function.parameters:
        if parameter.name == "self":
            continue
        star = {"variadic positional": "*", "variadic keyword": "**"}.get(parameter.kind.value, "")
        if parameter.kind.value == "keyword-only" and "*" not in parts and not any(p.startswith("*") for p in parts):
            parts.append("*")
        annotation = f": {parameter.annotation}" if parameter.annotation else ""
        default = f" = {parameter.default}" if parameter.default is not None and not star else ""
        parts.append(f"{star}{parameter.name}{annotation}{default}")
        positional = [p for p in function.parameters if p.kind.value == "positional-only"]
        if positional and parameter is positional[-1]:
            parts.append("/")
    returned = f" -> {function.returns}" if function.returns else ""
    line = f"def {function.name}({', '.join(parts)}){returned}: ..."
    if len(line) <= 110:
        return line
    return "\n".join([f"def {function.name}(", *(f"    {part}," for part in parts), f"){returned}: ..."])


def _docstring(thing: Any) -> str:
    lines = []
    for section in thing.docstring.parsed if thing.docstring else []:
        if section.kind.value == "text":
            lines += [_plain(section.value), ""]
        elif section.kind.value in ("parameters", "raises", "returns", "attributes"):
            lines += [f"**{section.kind.value.capitalize()}**", ""]
            for item in section.value:
                name = str(getattr(item, "name", "") or (item.annotation if section.kind.value == "raises" else ""))
                lines.append(f"- `{name}`: {_flat(item.description)}" if name else f"- {_flat(item.description)}")
            lines.append("")
        elif section.kind.value == "examples":
            code = "\n".join(text for _, text in section.value)
            lines += ["**Examples**", "", f"```pycon\n{code}\n```", ""]
        else:
            lines += [_plain(str(section.value)), ""]
    return "\n".join(lines)


def _item(signature: str, member: Any) -> str:
    text = _flat(member.docstring.value) if member.docstring else ""
    return f"- `{signature}`" + (f": {text}" if text else "")


def _method(function: Any) -> str:
    """A method: its signature, and what follows as a paragraph."""
    return f"```python\n{_signature(function)}\n```\n\n{_docstring(function)}"


def _plain(text: str) -> str:
    """A docstring with its indented blocks fenced."""
    return re.sub(r"(?:(?:^|(?<=\n)) {4}.*\n?(?:\n(?= {4}))?)+", _fenced, text)


def _fenced(block: re.Match[str]) -> str:
    lines = [line[4:] for line in block[0].rstrip().splitlines()]
    return "```python\n" + "\n".join(lines) + "\n```\n"


def _flat(text: str) -> str:
    return " ".join(text.split())


def _help(*words: str) -> str:
    """The help without its frames."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
        main([*words, "--help"])
    return re.sub(r" *│?$", "", out.getvalue().replace("│ ", "  "), flags=re.M)


def _command(name: str) -> str:
    """A command: what it does, its arguments, examples."""
    text = _help(name)
    body, examples = re.split(r"^examples?:\n", text, flags=re.M)
    rows: list[list[str]] = []
    for line in body.splitlines():
        found = re.match(r" {2}(-{1,2}\w.*?|[A-Z][\w.|/-]*)(?: {2,}(.*))?$", line)
        if found:
            rows.append([found[1], found[2] or ""])
        elif rows and line.startswith(" " * 8):
            rows[-1][1] += " " + line.strip()
    table = [f"| `{use}` | {does.strip()} |" for use, does in rows if "--help" not in use]
    table = [re.sub(r"(?<=[\w}])\|(?=\S)", r"\\|", row) for row in table]
    code = "\n".join(line.strip() for line in examples.splitlines())
    head = ["| argument | meaning |", "|---|---|"] if table else []
    about = _flat(text.split("\n\n")[1])
    return "\n".join([f"## {name}\n", f"{about}\n", *head, *table, "", f"```sh\n{code}\n```\n"])


if __name__ == "__main__":
    os.environ |= {"COLUMNS": "400", "NO_COLOR": "1"}
    (PAGES / "api.md").write_text(api(), encoding="utf-8")
    (PAGES / "cli.md").write_text(command_line(), encoding="utf-8")
