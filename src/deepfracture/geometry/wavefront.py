"""Wavefront OBJ with what its corners are painted with, and its MTL materials. Nothing outside the folder is read."""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

import numpy as np

from deepfracture.geometry.soup import TriangleSoup
from deepfracture.geometry.textures import read_sibling, texture
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Finish, Floats, Ints

Row = tuple[int, list[str]]
"""Number of a line in the file, and its words without the first."""


def read_obj(path: Path) -> TriangleSoup:
    """Polygons become fans; lines, points, groups and curves are passed over. Raises BadInput in one line."""
    rows = _rows(path)
    vertices = _numbers(path, rows["v"], 3, "vertex")
    colours = _colours(path, rows["v"])
    uv = _numbers(path, [(n, words[:2]) for n, words in rows["vt"]], 2, "texture coordinate")
    normals = _numbers(path, rows["vn"], 3, "normal")
    corners, finish, names = _triangles(path, rows)
    known = _mtl_finishes(path, rows["mtllib"]) if rows["usemtl"] else {}
    vertex, at_uv, at_normal = (corners[:, :, k] for k in range(3))
    return TriangleSoup(
        vertices,
        vertex,
        finish,
        tuple(known.get(name, Finish(name)) for name in names),
        _gather(normals, at_normal),
        _gather(uv, at_uv),
        None if colours is None else colours[vertex],
    )


def _rows(path: Path) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {key: [] for key in ("v", "vt", "vn", "f", "usemtl", "mtllib")}
    text = path.read_bytes().decode("utf-8-sig", "replace").replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#", 1)[0].split()
        if words and words[0] in rows:
            rows[words[0]].append((number, words[1:]))
    return rows


def _numbers(path: Path, rows: list[Row], width: int, what: str) -> Floats:
    """The first `width` numbers of each row, shape (n, width)."""
    try:
        if rows and len({len(words) for _, words in rows}) == 1:  # quick, and almost every file is so
            return np.array([words for _, words in rows], float)[:, :width].reshape(len(rows), width)
        return np.array([words[:width] for _, words in rows], float).reshape(len(rows), width)
    except ValueError:
        for number, words in rows:
            if len(words) < width or not all(_is_number(word) for word in words):
                raise _unreadable(path, number, f"a {what} of {width} numbers is expected") from None
        raise


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _is_index(text: str) -> bool:
    try:
        return abs(int(text)) < 1 << 63
    except ValueError:
        return False


def _colours(path: Path, rows: list[Row]) -> Floats | None:
    """Colours behind the positions, `v x y z r g b`, as many programs write them, shape (n, 4)."""
    if not rows or not all(len(words) in (6, 7) for _, words in rows):
        return None
    colours = _numbers(path, [(number, words[3:6]) for number, words in rows], 3, "colour")
    if not np.isfinite(colours).all():
        raise BadInput(f"{path}: vertex colours are NaN or infinite; export it again")
    colours = np.clip(colours / (255 if colours.max() > 1 else 1), 0, 1)
    return np.column_stack([colours, np.ones(len(colours))])


def _triangles(path: Path, rows: dict[str, list[Row]]) -> tuple[Ints, Ints, list[str]]:
    """Corners (m, 3, 3) as indices of vertex, texture coordinate, normal, -1 for none; finish (m,) and its names."""
    polygons, marks = rows["f"], rows["usemtl"]
    sizes = np.array([len(words) for _, words in polygons], np.int64)
    lines = np.array([number for number, _ in polygons], np.int64)
    if (sizes < 3).any():
        raise _unreadable(path, int(lines[sizes < 3][0]), "a face of three corners or more is expected")
    words = list(chain.from_iterable(words for _, words in polygons))
    corners = _indices(path, words, np.repeat(lines, sizes), rows)
    start = np.repeat(np.cumsum(sizes) - sizes, sizes - 2)
    face = np.repeat(np.arange(len(polygons)), sizes - 2)
    step = np.arange(len(face)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    fans = corners[np.column_stack([start, start + step + 1, start + step + 2])]
    called = [" ".join(words) for _, words in marks]
    names = list(dict.fromkeys(called))
    # What comes before the first usemtl has a finish without a name.
    mark = np.searchsorted([number for number, _ in marks], lines[face]) - 1
    number = {name: n for n, name in enumerate(names)}
    finish = np.array([*(number[name] for name in called), len(names)], np.int64)[mark]
    used, finish = np.unique(finish, return_inverse=True)
    return fans, finish.reshape(-1).astype(np.int64), [[*names, ""][k] for k in used]


def _indices(path: Path, words: list[str], lines: Ints, rows: dict[str, list[Row]]) -> Ints:
    """Corners `v`, `v/t`, `v//n` or `v/t/n` (k, 3), counted from 0, -1 for none.

    In the file they count from 1, or, negative, back from the line that they are on."""
    parts = [word.split("/") for word in words]
    corners = np.full((len(words), 3), -1, np.int64)
    for k, (key, what) in enumerate((("v", "vertex"), ("vt", "texture coordinate"), ("vn", "normal"))):
        texts = [part[k] if k < len(part) else "" for part in parts]
        given = np.array([bool(text) for text in texts], bool)
        try:
            index = np.array([int(text) for text in texts if text], np.int64)
        except (ValueError, OverflowError):
            bad = next(n for n, text in enumerate(texts) if text and not _is_index(text))
            raise _unreadable(path, int(lines[bad]), f"face corner {words[bad][:60]!r}") from None
        before = np.searchsorted([number for number, _ in rows[key]], lines[given])
        count = len(rows[key])
        index = np.where(index < 0, index + before, index - 1)
        wrong = (index < 0) | (index >= count)
        if wrong.any():
            bad = np.flatnonzero(given)[wrong][0]
            raise _unreadable(path, int(lines[bad]), f"{what} {texts[bad][:60]} of {count}; export it again")
        corners[given, k] = index
        if k == 0 and not given.all():
            bad = np.flatnonzero(~given)[0]
            raise _unreadable(path, int(lines[bad]), f"face corner {words[bad][:60]!r}")
    return corners


def _gather(values: Floats, index: Ints) -> Floats | None:
    """Values (k, c) at corners (m, 3), zero at those that have none; None if none has."""
    if not (index >= 0).any():
        return None
    return np.where((index >= 0)[:, :, None], values[index], 0.0)


def _mtl_finishes(path: Path, libraries: list[Row]) -> dict[str, Finish]:
    """The materials of an OBJ's MTL files, by name."""
    known: dict[str, Finish] = {}
    for name in (" ".join(words) for _, words in libraries):
        data = read_sibling(path, name)
        for block in re.split(r"(?m)^[ \t]*newmtl\b", (data or b"").decode("utf-8", "replace"))[1:]:
            lines = [line.split("#", 1)[0].split() for line in block.splitlines() or [""]]
            called = " ".join(lines[0])
            about = {words[0]: words[1:] for words in lines[1:] if words}
            known[called] = Finish(called, _colour(path, about.get("Kd")), _map(path, about.get("map_Kd")))
    return known


def _colour(path: Path, words: list[str] | None) -> tuple[int, int, int] | None:
    if words is None:
        return None
    if len(words) < 3 or not all(_is_number(word) and np.isfinite(float(word)) for word in words[:3]):
        log.warning("%s: Kd %s in its MTL file is no colour and is passed over", path, " ".join(words)[:40])
        return None
    red, green, blue = (round(255 * min(max(float(word), 0.0), 1.0)) for word in words[:3])
    return red, green, blue


def _map(path: Path, words: list[str] | None) -> bytes | None:
    """The picture of `map_Kd [-option values] name`."""
    if not words:
        return None
    while words[0].startswith("-") and len(words) > 1:
        values = 1
        while values < len(words) - 1 and (_is_number(words[values]) or words[values] in ("on", "off")):
            values += 1
        words = words[values:]
    return texture(path, " ".join(words))


def _unreadable(path: Path, line: int, what: str) -> BadInput:
    return BadInput(f"{path}: not a readable OBJ file (line {line}: {what})")
