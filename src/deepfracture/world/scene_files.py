"""Scene files, TOML or JSON: their tables are the dataclasses of `world.scene`, their keys the fields.

A field whose name in a file differs from the one in Python has it as `key` in its metadata."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput
from deepfracture.world.checks import shortened
from deepfracture.world.scene import Ball, Block, Floor, Placed, Scene

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports]

MAX_BYTES = 64 << 20
"""Of a scene file."""
TABLES = {"shapes": Placed, "balls": Ball, "blocks": Block}
"""Keys of a scene that are lists of tables."""


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene in a .toml or .json file. BadInput names the file and the field."""
    path = _scene_path(path)
    try:
        scene = _scene(_parsed(path))
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return replace(scene, shapes=tuple(_resolved(path, placed) for placed in scene.shapes))


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a .toml or .json file that `load_scene` reads back as the same scene."""
    path = _scene_path(path)
    data = _table(scene)
    text = _toml(data) if path.suffix == ".toml" else json.dumps(data, indent=2) + "\n"
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _scene_path(path: str | os.PathLike[str]) -> Path:
    path = Path(path)
    if path.suffix not in (".toml", ".json"):
        raise BadInput(f"{path}: a scene is a .toml or .json file")
    return path


def _resolved(path: Path, placed: Placed) -> Placed:
    """File names of shapes are relative to the scene's own folder."""
    file = path.parent / placed.shape
    return replace(placed, shape=str(file)) if os.path.isfile(file) else placed  # or no path at all


def _parsed(path: Path) -> Any:
    """The data in a file; BadInput does not name the file."""
    try:
        if path.exists() and not path.is_file():  # a device may have no end
            raise BadInput("is not a file")
        if path.stat().st_size > MAX_BYTES:
            raise BadInput(f"larger than {MAX_BYTES >> 20} MB, too large for a scene")
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except BadInput:
        raise
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise BadInput("cannot be read: not UTF-8 text") from error
    except RecursionError as error:
        raise BadInput(f"not {path.suffix[1:].upper()} of a scene: nested too deeply") from error
    except ValueError as error:  # of the parsers, or a number of thousands of digits
        raise BadInput(f"not {path.suffix[1:].upper()}: {str(error).splitlines()[0][:200]}") from error


# Reading: tables into dataclasses, with the name of the field in every message.


def _scene(data: Any) -> Scene:
    known = _known(Scene, data, "the file")
    for key, cls in TABLES.items():
        if key in known:
            if not isinstance(known[key], list):
                raise BadInput(f"{key} must be a list of tables, got {shortened(known[key])}")
            known[key] = tuple(_record(cls, entry, f"{key}[{i}]") for i, entry in enumerate(known[key]))
    if "floor" in known:
        known["floor"] = _record(Floor, known["floor"], "floor")
    return _made(Scene, known)


def _record(cls: type, data: Any, where: str) -> Any:
    known = _known(cls, data, where)
    try:
        return _made(cls, {key: tuple(v) if isinstance(v, list) else v for key, v in known.items()})
    except BadInput as error:
        raise BadInput(f"{where}.{error}") from error


def _made(cls: type, known: dict[str, Any]) -> Any:
    """A dataclass from values by key."""
    names = {_key(field): field.name for field in fields(cls)}
    try:
        return cls(**{names[key]: value for key, value in known.items()})
    except BadInput as error:  # whose message begins with the name of the field
        keys = {name: key for key, name in names.items()}
        raise BadInput(re.sub(r"^\w+", lambda word: keys.get(word[0], word[0]), str(error))) from error


def _known(cls: type, data: Any, where: str) -> dict[str, Any]:
    """A table that has all the keys it needs and no others."""
    if not isinstance(data, Mapping):
        raise BadInput(f"{where} must be a table, got {shortened(data)}")
    keys = [_key(field) for field in fields(cls)]
    for key in data:
        if key not in keys:
            raise BadInput(
                f"{where} has an unknown field {shortened(key)}; it may have {', '.join(keys)}{did_you_mean(key, keys)}"
            )
    for field in fields(cls):
        if _key(field) not in data and field.default is MISSING and field.default_factory is MISSING:
            raise BadInput(f"{where} lacks the field {_key(field)!r}")
    return dict(data)


def _key(field: Field) -> str:
    return field.metadata.get("key", field.name)


# Writing: TOML has no writer in the standard library, and this is all that a scene needs of it.


def _table(record: Any) -> dict[str, Any]:
    """A dataclass as values by key, without those that are None."""
    values = {_key(field): getattr(record, field.name) for field in fields(record)}
    return {key: _plain(value) for key, value in values.items() if value is not None}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return _table(value) if is_dataclass(value) else value


def _toml(data: dict[str, Any]) -> str:
    plain = {k: v for k, v in data.items() if not isinstance(v, dict) and k not in TABLES}
    lines = [f"{key} = {_literal(value)}" for key, value in plain.items()]
    if "floor" in data:
        lines += ["", "[floor]", *(f"{k} = {_literal(v)}" for k, v in data["floor"].items())]
    for table in TABLES:
        for entry in data[table]:
            lines += ["", f"[[{table}]]", *(f"{k} = {_literal(v)}" for k, v in entry.items())]
    return "\n".join(lines) + "\n"


def _literal(value: Any) -> str:
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_literal(v) for v in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
