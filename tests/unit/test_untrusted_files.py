"""Files from strangers: they can neither run code, nor write outside their folder, nor take unbounded memory.

What they may hold at all is the business of the fuzzers (`tests/property/test_fuzz_readers.py`)."""

from __future__ import annotations

import ast
import io
import json
import logging
import os
import pickle
import runpy
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deepfracture.cli.info import info
from deepfracture.export import write_fragments, write_glb, write_sequence, write_usd
from deepfracture.fracture.cache import _load_array
from deepfracture.fracture.elastostatics import ElasticBody
from deepfracture.geometry import load_shape
from deepfracture.learn import embedded_model, load_model, model_kind
from deepfracture.learn.checkpoint import KEY, read
from deepfracture.play.uploads import read_upload
from deepfracture.runtime.files import FORMER, LOCK, NEW, PREFIX, atomic_contents, atomic_folder, remove_stale
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput
from deepfracture.world import load_scene

SOURCE = Path(__file__).parents[2] / "src" / "deepfracture"
MANY = 10**12
ENOUGH = 100_000_000
"""Bytes that no refusal may take."""
painted = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "painted.py"))


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    before = log.level
    log.setLevel(logging.CRITICAL)
    yield
    log.setLevel(before)


def readers() -> dict[str, Callable[[Path], object]]:
    """By the name of a file that they would read."""
    meshes = {
        f"mesh.{kind}": lambda path: load_shape(str(path)) for kind in ("obj", "ply", "stl", "off", "glb", "gltf")
    }
    return meshes | {
        "model.safetensors": load_model,
        "field.safetensors": model_kind,
        "checkpoint.safetensors": lambda path: read(path, "training checkpoint"),
        "scene.toml": load_scene,
        "scene.json": load_scene,
        "report.json": lambda path: info(str(path)),
        "a.elastic": ElasticBody.load,
        "a.distances": _load_array,
    }


class Payload:
    """Unpickled, it makes a file."""

    def __init__(self, trap: Path) -> None:
        self.trap = trap

    def __reduce__(self) -> tuple:
        return os.mkdir, (str(self.trap),)


# Code.


@pytest.mark.parametrize("name", list(readers()))
@pytest.mark.parametrize("kind", ["pickle", "torch", "numpy", "zipped numpy"])
def test_no_file_runs_code(kind: str, name: str, tmp_path: Path) -> None:
    trap, path = tmp_path / "trap", tmp_path / name
    payload = np.array([Payload(trap)], object)
    held = io.BytesIO()
    if kind == "pickle":
        pickle.dump(Payload(trap), held)
    elif kind == "torch":  # a zip with a pickle in it
        with zipfile.ZipFile(held, "w") as packed:
            packed.writestr("archive/data.pkl", pickle.dumps(Payload(trap)))
            packed.writestr("archive/version", "3")
    elif kind == "numpy":
        np.save(held, payload, allow_pickle=True)
    else:
        np.savez(held, allow_pickle=True, **dict.fromkeys(("format", "vertices", "faces", "factor"), payload))
    path.write_bytes(held.getvalue())
    with pytest.raises(BadInput):
        readers()[name](path)
    assert not trap.exists()


def test_the_payload_would_make_its_file(tmp_path: Path) -> None:
    """Else the test above could not fail."""
    pickle.loads(pickle.dumps(Payload(tmp_path / "trap")))
    assert (tmp_path / "trap").exists()


def test_nothing_in_the_program_reads_what_could_run_code() -> None:
    """No pickle, no eval; numpy is always told not to."""
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = {alias.name.split(".")[0] for alias in node.names} | {getattr(node, "module", "") or ""}
                assert not names & {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "yaml"}, path
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in ("eval", "exec", "torch.load", "np.fromregex"), f"{path}: {called}"
                if called in ("np.load", "numpy.load"):
                    allowed = [word for word in node.keywords if word.arg == "allow_pickle"]
                    assert allowed and ast.unparse(allowed[0].value) == "False", f"{path}: {ast.unparse(node)}"


# Places.


def tree(folder: Path, but: Path) -> dict[Path, bytes]:
    """All files in a folder and what they hold, but those below `but`."""
    files = [path for path in folder.rglob("*") if path.is_file() and but not in path.parents]
    return {path: path.read_bytes() for path in files}


@pytest.mark.parametrize("name", ["../../evil", "/tmp/evil", "..\\evil", "a\0b", "CON", ".", ".."])
def test_names_in_a_mesh_name_no_files(name: str, tmp_path: Path) -> None:
    """A material, and with it its texture, called like a place elsewhere: no exporter writes there."""
    inside = tmp_path / "deep" / "mesh"
    inside.mkdir(parents=True)
    mesh = painted["write_cube"](inside)
    for file in (mesh, inside / "cube.mtl"):
        file.write_text(file.read_text().replace("glaze", name))
    shape = load_shape(str(mesh))
    pieces = painted["broken"](shape, resolution=32)
    recording = painted["filmed"](shape, pieces)
    out = tmp_path / "deep" / "out"
    before = tree(tmp_path, out)
    write_fragments(pieces, shape, out / "fragments")
    write_glb(recording, out / "a.glb")
    write_sequence(recording, out / "obj", kind="obj", rate=2.0)
    if find_spec("pxr") is not None:
        write_usd(recording, out / "a.usda")
    assert tree(tmp_path, out) == before
    assert not Path("/tmp/evil").exists()
    assert all(path.resolve().is_relative_to(out) for path in out.rglob("*"))


@pytest.mark.parametrize(
    "name", ["../../evil.obj", "/tmp/evil.obj", "..\\..\\evil.obj", "a/b/c.obj", "x" * 999 + ".obj"]
)
def test_an_upload_lies_where_we_say(name: str, tmp_path: Path) -> None:
    mesh = painted["write_cube"](tmp_path)
    own = tmp_path / "own"
    before = tree(tmp_path, own)
    entry = read_upload(mesh.read_bytes(), name, own, limit=1 << 20)
    assert entry.file == own / "mesh.obj"
    assert tree(tmp_path, own) == before
    assert "/" not in entry.label and "\\" not in entry.label and len(entry.label) <= 40


@pytest.mark.parametrize(
    "name", ["../secret.png", "/etc/passwd", "link.png", "folder/../../secret.png", "%2e%2e/secret.png"]
)
def test_a_mesh_does_not_show_what_lies_beside_its_folder(name: str, tmp_path: Path) -> None:
    """A picture elsewhere does not travel with the fragments."""
    inside = tmp_path / "mesh"
    (inside / "folder").mkdir(parents=True)
    Image.new("RGB", (2, 2), (1, 2, 3)).save(tmp_path / "secret.png")
    (inside / "link.png").symlink_to(tmp_path / "secret.png")
    mesh = painted["write_cube"](inside)
    library = inside / "cube.mtl"
    library.write_text(library.read_text().replace("tiles.png", name))
    looks = load_shape(str(mesh)).appearance
    assert looks is not None and all(finish.texture is None for finish in looks.finishes)


def test_results_do_not_go_through_links(tmp_path: Path) -> None:
    """A folder of a stranger, in which the names that we write to are links to something dear."""
    dear = tmp_path / "dear"
    dear.mkdir()
    (dear / "file").write_text("dear")
    out = tmp_path / "out"
    out.mkdir()
    (out / "animation.glb").symlink_to(dear / "file")
    (out / "fragments").symlink_to(dear)
    (out / "lost").symlink_to(tmp_path / "nowhere")
    with atomic_contents(out, last="report.json") as folder:
        for name in ("animation.glb", "report.json"):
            (folder / name).write_text("new")
        for name in ("fragments", "lost"):
            with atomic_folder(folder / name) as inner:
                (inner / "file").write_text("new")
    assert (dear / "file").read_text() == "dear" and [path.name for path in dear.iterdir()] == ["file"]
    assert (out / "fragments" / "file").read_text() == (out / "lost" / "file").read_text() == "new"
    assert not any(path.is_symlink() for path in out.iterdir()) and not (tmp_path / "nowhere").exists()


# Memory.


def safetensors(head: object, data: bytes = b"") -> bytes:
    text = head if isinstance(head, bytes) else json.dumps(head).encode()
    return struct.pack("<Q", len(text)) + text + data


def shipped(**facts: object) -> bytes:
    """The pot's model with other facts in its head."""
    path = embedded_model("pot")
    assert path is not None
    data = path.read_bytes()
    length = struct.unpack("<Q", data[:8])[0]
    head = json.loads(data[8 : 8 + length])
    said = json.loads(head["__metadata__"][KEY])
    for name, value in facts.items():
        said[name] = {**said[name], **value} if isinstance(value, dict) else value
    head["__metadata__"][KEY] = json.dumps(said)
    return safetensors(head, data[8 + length :])


@cache
def bomb() -> bytes:
    """A model whose distance to the surface, a few kilobytes, unpacks to half a gigabyte."""
    from safetensors.numpy import load, save

    path = embedded_model("pot")
    assert path is not None
    data = path.read_bytes()
    length = struct.unpack("<Q", data[:8])[0]
    said = json.loads(data[8 : 8 + length])["__metadata__"]
    packer = zlib.compressobj(1)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(512)) + packer.flush()
    return save({**load(data), "surface": np.frombuffer(packed, np.uint8)}, said)


def npy(shape: str) -> bytes:
    head = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode()


def zipped(member: bytes) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as packed:
        for name in ("format", "vertices", "faces", "poisson", "factor", "pivots", "single_layer", "centre"):
            packed.writestr(f"{name}.npy", member)
    return held.getvalue()


@cache
def liars() -> dict[str, tuple[str, bytes]]:
    """Files that say that they are large."""
    tensor = {"dtype": "F32", "shape": [MANY], "data_offsets": [0, 4 * MANY]}
    ply = f"ply\nformat binary_little_endian 1.0\nelement vertex {MANY}\nproperty float x\nproperty float y\n"
    ply += f"property float z\nelement face {MANY}\nproperty list uchar int vertex_indices\nend_header\n"
    accessor = {"componentType": 5126, "count": MANY, "type": "VEC3"}
    gltf = {"asset": {"version": "2.0"}, "accessors": [accessor], "scenes": [{"nodes": [0]}], "scene": 0,
            "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}  # fmt: skip
    scene = 'duration = 1e300\nframe_rate = 60\n[[shapes]]\nshape = "pot"\nmaterial = "plaster"\n'
    fast = scene.replace("60", str(MANY)).replace("1e300", "1")
    config = {"hidden": MANY, "basis": MANY, "impulse_size": MANY}
    return {
        "a tensor of 10^12 numbers": ("model.safetensors", safetensors({"a": tensor, "__metadata__": {KEY: "{}"}})),
        "a head of 10^12 bytes": ("model.safetensors", struct.pack("<Q", MANY) + b"{}"),
        "sizes of 10^12": ("model.safetensors", shipped(config=config)),
        "10^12 channels": ("model.safetensors", shipped(channels=MANY)),
        "a resolution of 10^12": ("model.safetensors", shipped(resolution=MANY)),
        "a surface that unpacks to half a gigabyte": ("model.safetensors", bomb()),
        "10^12 vertices": ("mesh.ply", ply.encode() + bytes(1000)),
        "an STL of 4 10^9 faces": ("mesh.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(1000)),
        "an OFF of 10^12 faces": ("mesh.off", f"OFF\n{MANY} {MANY} 0\n0 0 0\n".encode()),
        "a glTF of 10^12 vertices": ("mesh.gltf", json.dumps(gltf).encode()),
        "a scene that lasts for ever": ("scene.toml", scene.encode()),
        "a scene of 10^12 frames a second": (
            "scene.toml",
            fast.encode(),
        ),
        "distances of 10^12": ("a.distances", npy(f"({MANY},)")),
        "a body that unpacks to a gigabyte": ("a.elastic", zipped(npy("(100,)") + bytes(1 << 27))),
    }


@pytest.mark.parametrize("what", list(liars()))
def test_no_file_takes_memory_because_it_says_so(what: str, tmp_path: Path) -> None:
    name, content = liars()[what]
    path = tmp_path / name
    path.write_bytes(content)
    reader = readers()[name]
    if what == "a surface that unpacks to half a gigabyte":  # as much of it as a surface has is read, and is one
        load_model(path)
    load_model(embedded_model("pot"))  # pyright: ignore[reportArgumentType]
    tracemalloc.start()
    try:
        if what == "a surface that unpacks to half a gigabyte":
            reader(path)
        else:
            with pytest.raises(BadInput) as refused:
                reader(path)
            assert "\n" not in str(refused.value)
        assert tracemalloc.get_traced_memory()[1] < ENOUGH + len(content)
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["scene.toml", "scene.json"])
def test_a_scene_of_gigabytes_is_not_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    with open(path, "wb") as file:
        file.truncate(1 << 33)  # takes no room on disk
    with pytest.raises(BadInput, match="too large"):
        load_scene(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="has no /dev/zero")
@pytest.mark.parametrize("name", list(readers()))
def test_a_link_to_a_device_without_an_end_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / name).symlink_to("/dev/zero")
    with pytest.raises(BadInput):
        readers()[name](tmp_path / name)


def test_sweeping_follows_no_link_out_of_the_folder(tmp_path: Path) -> None:
    """A folder from a stranger may hold what looks like a leftover of ours."""
    elsewhere, given = tmp_path / "elsewhere", tmp_path / "given"
    left = given / f"{PREFIX}abcdefgh"
    elsewhere.mkdir()
    left.mkdir(parents=True)
    (elsewhere / "letter.txt").write_text("mine")
    (left / LOCK).touch()
    for name in (NEW, FORMER):
        (left / name).symlink_to(elsewhere)
    remove_stale(given)
    assert (elsewhere / "letter.txt").read_text() == "mine"
    assert not (given / "letter.txt").exists()
