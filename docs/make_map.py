"""Draw the map of the rooms, docs/images/map.svg, from the imports of the source.

    python docs/make_map.py

A room stands above every room that it imports. An arrow is left out where a path of others leads to the same room, and
so are those to `types` and `runtime`, which every room may import.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "deepfracture"
PICTURE = ROOT / "docs" / "images" / "map.svg"
SHARED = ("types", "runtime")
WIDTH, HEIGHT, ROW = 96, 30, 78
"""Of a box, and from row to row [pixels]."""

Graph = dict[str, set[str]]


def file_graph(source: Path = SOURCE) -> Graph:
    """The files that each file imports, inside functions too, as paths below `source` without `.py`."""
    files = {path.relative_to(source).with_suffix("").as_posix() for path in source.rglob("*.py")}
    return {name: _imported(source / f"{name}.py", files) - {name} for name in sorted(files)}


def room_graph(files: Mapping[str, set[str]]) -> Graph:
    """The rooms that each room imports: folders, and those files at the root that others import."""
    rooms: Graph = {}
    for name, imported in files.items():
        rooms.setdefault(name.split("/")[0], set()).update(other.split("/")[0] for other in imported)
    shown = {name.split("/")[0] for name in files if "/" in name} | set().union(*rooms.values())
    shown = {room for room in shown if not room.startswith("_")}
    return {room: (others & shown) - {room} for room, others in rooms.items() if room in shown}


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Groups of nodes that can reach each other."""
    reached = {node: _reachable(graph, node) for node in graph}
    groups = {tuple(sorted(b for b in reached[a] if a in reached[b])) for a in graph if a in reached[a]}
    return sorted(map(list, groups))


def draw(rooms: Mapping[str, set[str]]) -> str:
    """The map as SVG, in layers (Sugiyama, Tagawa & Toda 1981)."""
    graph = _reduced({room: others - {*SHARED} for room, others in rooms.items() if room not in SHARED})
    paths, rows = _layers(graph)
    wide, high = max(map(len, rows)) * (WIDTH + 24) + 24, (len(rows) + 1) * ROW
    place = {
        node: (wide * (i + 1) / (len(row) + 1), high - ROW * (level + 1.5))
        for level, row in enumerate(rows)
        for i, node in enumerate(row)
    }
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" font-family="sans-serif" font-size="14">',
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L10 5L0 10z" fill="#8d6e63"/></marker></defs>',
        f'<rect width="{wide}" height="{high}" fill="#fffaf5"/>',
        *(_arrow([place[node] for node in path]) for path in paths),
        *(_box(room, *place[room], WIDTH) for room in sorted(graph)),
        _box(" and ".join(SHARED) + ": every room may import them", wide / 2, high - ROW / 2, wide - 48),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _imported(path: Path, files: set[str]) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {_file(alias.name, "", files) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {_file(node.module or "", alias.name, files) for alias in node.names}
    return found - {""}


def _file(module: str, name: str, files: set[str]) -> str:
    """The file that `from module import name` reads, "" for another package's."""
    package, *parts = module.split(".")
    if package != "deepfracture":
        return ""
    choices = ("/".join([*parts, name]), "/".join(parts), "/".join([*parts, name, "__init__"]))
    return next((c for c in (*choices, "/".join([*parts, "__init__"])) if c in files), "")


def _reachable(graph: Mapping[str, set[str]], start: str) -> set[str]:
    seen: set[str] = set()
    todo = list(graph[start])
    while todo:
        node = todo.pop()
        if node not in seen:
            seen.add(node)
            todo += graph[node]
    return seen


def _reduced(graph: Mapping[str, set[str]]) -> Graph:
    """The transitive reduction (Aho, Garey & Ullman 1972) of a graph without circles."""
    beyond = {node: set().union(*(_reachable(graph, other) for other in graph[node])) for node in graph}
    return {node: graph[node] - beyond[node] for node in graph}


def _layers(graph: Mapping[str, set[str]]) -> tuple[list[list[str]], list[list[str]]]:
    """The nodes along each arrow, which passes through a row by a node of its own, and the rows from the lowest."""
    level = _levels(graph)
    paths = []
    for room in sorted(graph):
        for other in sorted(graph[room]):
            between = [f"{room}>{other}@{k}" for k in range(level[room] - 1, level[other], -1)]
            level |= {node: int(node.split("@")[1]) for node in between}
            paths.append([room, *between, other])
    near: dict[str, list[str]] = {node: [] for node in level}
    for path in paths:
        for a, b in itertools.pairwise(path):
            near[a].append(b)
            near[b].append(a)
    rows = [sorted(node for node in level if level[node] == k) for k in range(1 + max(level.values()))]
    for sweep in range(8):  # each row by the mean place of its neighbours in the row before it: up, down, up ...
        way = -1 if sweep % 2 else 1
        for k, row in list(enumerate(rows))[::way]:
            if 0 <= k - way < len(rows):
                before = rows[k - way]
                place = {node: (i + 1) / (len(before) + 1) for i, node in enumerate(before)}
                mean = {n: [place[o] for o in near[n] if o in place] or [0.5] for n in row}
                row.sort(key=lambda n, mean=mean: (sum(mean[n]) / len(mean[n]), n))
    return paths, rows


def _levels(graph: Mapping[str, set[str]]) -> dict[str, int]:
    """The row of each room: above all that it imports, and as high as the rooms that import it allow."""
    level: dict[str, int] = {}
    while len(level) < len(graph):
        level |= {
            room: 1 + max((level[other] for other in graph[room]), default=-1)
            for room in sorted(graph)
            if graph[room] <= level.keys()
        }
    for room in sorted(graph, key=lambda room: -level[room]):
        level[room] = min((level[other] - 1 for other in graph if room in graph[other]), default=max(level.values()))
    return level


def _arrow(points: list[tuple[float, float]]) -> str:
    (x, y), half = points[0], HEIGHT / 2
    path = f"M{x:.0f} {y + half:.0f}"
    y += half
    for k, (u, v) in enumerate(points[1:], 2):
        end = v - half - (k == len(points))
        bend = (end - y) / 2
        path += f"C{x:.0f} {y + bend:.0f} {u:.0f} {end - bend:.0f} {u:.0f} {end:.0f}"
        x, y = u, v + half
        if k < len(points):
            path += f"V{y:.0f}"
    return f'<path d="{path}" fill="none" stroke="#bcaaa4" stroke-width="1.3" marker-end="url(#tip)"/>'


def _box(text: str, x: float, y: float, width: float) -> str:
    corner = f'x="{x - width / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{width:.0f}" height="{HEIGHT}"'
    box = f'<rect {corner} rx="6" fill="#efe3d8" stroke="#6d4c41"/>'
    return f'{box}<text x="{x:.0f}" y="{y + 5:.0f}" text-anchor="middle" fill="#3e2723">{text}</text>'


if __name__ == "__main__":
    PICTURE.write_text(draw(room_graph(file_graph())), encoding="utf-8")
