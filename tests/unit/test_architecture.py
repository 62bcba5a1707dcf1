"""The import arrows of docs/explanation/architecture.md, read from the code."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src" / "deepfracture"
SHARED = {"types", "runtime"}
ARROWS = {
    "runtime": set(),
    "geometry": set(),
    "voxels": {"geometry"},
    "fracture": {"geometry", "voxels"},
    "carve": {"geometry", "voxels"},
    "world": {"geometry"},
    "recording": {"geometry"},
    "render": {"geometry", "recording"},
    "export": {"geometry", "recording", "render"},
    "dataset": {"geometry", "fracture", "carve", "world"},
    "compare": {"geometry", "carve"},
    "learn": {"geometry", "voxels", "carve", "compare", "dataset"},
    "breakers": {"geometry", "voxels", "fracture", "carve", "dataset", "learn"},
    "evaluate": {"geometry", "carve", "compare", "dataset", "learn", "breakers"},
    "validation": {"geometry", "fracture", "world"},
    "play": {"geometry", "fracture", "learn", "breakers", "world", "recording", "render", "export"},
    "soak": {"geometry", "fracture", "learn", "breakers", "world", "validation"},
    "bench": {"geometry", "fracture", "carve", "world", "export", "dataset", "learn", "breakers", "render"},
}
HEAVY = {
    "torch": {"learn"},
    "pybullet": {"world"},
    "rapier3d": {"world"},
    "manifold3d": {"carve", "geometry", "bench"},
    "pxr": {"export"},
    "viser": {"export", "play"},
    "pyvista": set(),  # no VTK: it is large, and needs a graphics driver
    "vtkmodules": set(),
    "zarr": {"dataset"},
    "obstore": {"dataset"},
    "ray": {"dataset"},
}


def imports(path: Path) -> set[str]:
    """Dotted names that a file imports, relative ones made absolute."""
    package = ("deepfracture", *path.relative_to(SOURCE).parts[:-1])
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    return found


@pytest.mark.parametrize("room", ARROWS)
def test_rooms_import_only_what_the_arrows_allow(room: str) -> None:
    allowed = ARROWS[room] | SHARED | {room}
    for path in (SOURCE / room).rglob("*.py"):
        for name in imports(path):
            parts = name.split(".")
            if parts[0] == "deepfracture" and len(parts) > 1 and parts[1] != "_version":
                assert parts[1] in allowed, f"{path.relative_to(SOURCE)} imports {name}"


def test_every_room_has_its_arrows() -> None:
    rooms = {path.parent.name for path in SOURCE.glob("*/__init__.py")}
    assert rooms == {*ARROWS, "cli"}


def test_the_nouns_need_numpy_only() -> None:
    for name in imports(SOURCE / "types.py"):
        assert name.split(".")[0] in {"__future__", "collections", "dataclasses", "typing", "numpy"}, name


def test_heavy_libraries_stay_in_their_rooms() -> None:
    for path in SOURCE.rglob("*.py"):
        room = path.relative_to(SOURCE).parts[0]
        for name in imports(path):
            library = name.split(".")[0]
            assert library not in HEAVY or room in HEAVY[library], f"{path.relative_to(SOURCE)} imports {library}"


def test_importing_the_program_loads_nothing_heavy() -> None:
    code = "import sys, deepfracture, deepfracture.cli; print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    loaded = {name.split(".")[0] for name in out.split()}
    assert not loaded & {
        "torch",
        "numba",
        "scipy",
        "pybullet",
        "pyvista",
        "viser",
        "zarr",
        "manifold3d",
        "matplotlib",
        "pxr",
    }


def test_no_files_import_each_other_in_a_circle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SOURCE.parents[1] / "docs"))
    from make_map import circles, file_graph

    assert circles(file_graph()) == []


def test_imports_are_absolute() -> None:
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            assert not (isinstance(node, ast.ImportFrom) and node.level), f"{path.relative_to(SOURCE)}:{node.lineno}"
