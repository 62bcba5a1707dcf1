"""Table of docs/reports/untrusted_input.md: fuzzing of every reader, which returns an object or a one-line error.

    python benchmarks/fuzz.py --minutes 30 --log fuzz.json

Each reader gets a process of its own with limits of memory and time, and valid files to start from. They are mutated:
cut off, bytes flipped, numbers swapped for hostile ones, counts in heads made to lie, parts repeated, nested ten
thousand deep. Where atheris is installed it steers by coverage of the readers' own code (libFuzzer); else the same
mutations are drawn at random. What a reader answers with anything but an object or `BadInput` of one line, and what
takes longer, more memory, or kills the process, is a finding: it is kept with its bytes and the place in the code.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
import logging
import os
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hostile_files as plain
import numpy as np
from harness import start, table, write_json, write_text

from deepfracture.types import BadInput

MEMORY = 3 << 30
"""Bytes of memory that a process may have beyond what it begins with."""
SECONDS = 20
"""That a reading may take."""
LARGEST = 1 << 18
"""Bytes of a mutated file at most."""
NUMBERS = (
    "0", "-1", "1", "2", "255", "256", "32767", "65536", "2147483647", "-2147483648", "4294967295", "4294967296",
    "1000000000000", "9223372036854775807", "18446744073709551616", "1e18", "1e308", "1e400", "-1e-320", "nan", "inf",
    "-inf", "NaN", "Infinity", "1" * 5000, "0x10", "1_0", "", "null", "true", "[]", "{}", '""', "[1]", "one", "\u0663",
    "0.5", "-0.0",
)  # fmt: skip
WORDS = ("../../etc/passwd", "/etc/passwd", "/dev/zero", "a\0b", "x" * 5000, "", ".", "CON", "\udcff", "\u202e", "-rf")
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
QUOTED = re.compile(rb'"[^"\\]{0,200}"')
WATCH = [
    *(f"deepfracture.geometry.{name}" for name in ("read", "wavefront", "soup", "textures")),
    *(f"trimesh.exchange.{name}" for name in ("gltf", "ply", "stl", "off")), "trimesh.visual.material",
    "deepfracture.world.scene", "deepfracture.cli.info", "deepfracture.fracture.cache", "deepfracture.dataset.settings",
    "deepfracture.learn.checkpoint", "deepfracture.learn.partition.model", "deepfracture.learn.partition.config",
    "deepfracture.learn.published.config",
]  # fmt: skip
"""Modules whose coverage steers: those without compiled kernels."""
Move = tuple[int, int, int]
"""Which mutation, where (a share of 2^16), and what."""


# Mutations.


def mutate(data: bytes, moves: Sequence[Move], others: Sequence[bytes] = ()) -> bytes:
    """`data` after some moves; in files with a JSON head, half of them stay inside of it, and the head stays a head."""
    for kind, where, what in moves:
        inner = _head(data)
        if inner is None or what % 2:
            data = MUTATIONS[kind % len(MUTATIONS)](data, where, what // 2, others)
        else:
            text, rebuilt = inner
            data = rebuilt(MUTATIONS[kind % len(MUTATIONS)](text, where, what // 2, others))
        data = data[:LARGEST]
    return data


def _head(data: bytes) -> tuple[bytes, Callable[[bytes], bytes]] | None:
    """The JSON in the head of a GLB or safetensors file, and how a file is made with another one."""
    if data[:4] == b"glTF" and len(data) > 20:
        length = min(struct.unpack("<I", data[12:16])[0], len(data) - 20)
        rest = data[20 + length :]

        def glb(text: bytes) -> bytes:
            text += b" " * (-len(text) % 4)
            total = 20 + len(text) + len(rest)
            return data[:8] + struct.pack("<II", total, len(text)) + data[16:20] + text + rest

        return data[20 : 20 + length], glb
    if len(data) > 16 and data[8:9] == b"{" and (length := struct.unpack("<Q", data[:8])[0]) <= len(data) - 8:
        return data[8 : 8 + length], lambda text: struct.pack("<Q", len(text)) + text + data[8 + length :]
    return None


def _at(data: bytes, where: int) -> int:
    return where * len(data) >> 16


def _cut(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    return data[: _at(data, where)]


def _flip(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    at = _at(data, where)
    return data[:at] + bytes(b ^ (what & 255 or 1) for b in data[at : at + 1]) + data[at + 1 :]


def _integer(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    values = (0, 1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)
    size, order = 1 << (what & 3), "little" if what & 4 else "big"
    value = (values[what >> 3 & 15] if what >> 3 & 15 < len(values) else what) % (1 << 8 * size)
    at = _at(data, where)
    return data[:at] + value.to_bytes(size, order) + data[at + size :]


def _drop(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    at = _at(data, where)
    return data[:at] + data[at + 1 + what % 64 :]


def _repeat(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    at, size = _at(data, where), 1 + what % 256
    return data[:at] + data[at : at + size] * (2 + what % 7 * 40) + data[at + size :]


def _number(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    return _swapped(data, where, NUMBER, NUMBERS[what % len(NUMBERS)].encode())


def _word(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    return _swapped(data, where, QUOTED, b'"' + WORDS[what % len(WORDS)].encode("utf-8", "surrogatepass") + b'"')


def _swapped(data: bytes, where: int, pattern: re.Pattern[bytes], new: bytes) -> bytes:
    """The first match from some place on, swapped."""
    found = pattern.search(data, _at(data, where)) or pattern.search(data)
    return data if found is None else data[: found.start()] + new + data[found.end() :]


def _nest(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    text = (b"[", b'{"a":', b"[[", b"(", b"{", b"a.")[what % 6]
    found = NUMBER.search(data, _at(data, where))
    at = found.start() if found else _at(data, where)
    return data[:at] + text * (10 if what & 8 else 20_000) + data[at:]


def _swap_lines(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    lines = data.split(b"\n")
    one, other = where * len(lines) >> 16, what % len(lines)
    lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines)


def _join(data: bytes, where: int, what: int, others: Sequence[bytes]) -> bytes:
    other = others[what % len(others)] if others else data
    return data[: _at(data, where)] + other[_at(other, where) :]


MUTATIONS: tuple[Callable[[bytes, int, int, Sequence[bytes]], bytes], ...] = (
    _number, _flip, _cut, _integer, _number, _drop, _repeat, _word, _nest, _swap_lines, _join, _number,
)  # fmt: skip


def random_moves(rng: np.random.Generator) -> list[Move]:
    count = 1 + int(rng.geometric(0.5))
    return [tuple(row) for row in rng.integers(0, 1 << 16, (count, 3)).tolist()]


# Readers.


@dataclass(frozen=True)
class Reader:
    """One reader of one kind of file."""

    name: str
    file: str
    """What the file is called; in a folder where it is one of several."""
    read: Callable[[Path], Any]
    """Reads the folder that the file is in."""
    seeds: Callable[[Path], Sequence[Path]]
    """Writes valid folders into a folder."""


def outcome(reader: Reader, folder: Path) -> str:
    """ "read" or "refused"; AssertionError where it is refused in another way than by one line.

    Everything else that a reader raises passes through."""
    try:
        reader.read(folder)
    except BadInput as refused:
        text = str(refused)
        assert text and "\n" not in text, f"not one line: {text[:200]!r}"
        assert len(text) < 6000, f"a line of {len(text)} characters"
        return "refused"
    return "read"


def readers() -> dict[str, Reader]:
    """Every reader by name."""
    found = [_mesh(f"mesh.{kind}") for kind in ("obj", "ply", "stl", "off", "glb", "gltf")]
    found += [Reader("mesh.mtl", "cube.mtl", _load("cube.obj"), _cube)]
    found += [Reader(f"scene{kind}", f"scene{kind}", _scene(kind), _scenes) for kind in (".toml", ".json")]
    found += [
        Reader("model", "model.safetensors", _model, _models),
        Reader("field-model", "field.safetensors", _field_model, _models),
        Reader("checkpoint", "run/checkpoint.safetensors", _checkpoint, _models),
        Reader("report", "report.json", _info("report.json"), _reports),
        Reader("dataset", "data/dataset.json", _dataset, _datasets),
        Reader("dataset-arrays", "data/*", _dataset, _datasets),
        Reader("elastic", "body.elastic", _elastic, _elastics),
        Reader("distances", "body.distances", _distances, _elastics),
    ]
    return {reader.name: reader for reader in found}


def _load(name: str) -> Callable[[Path], Any]:
    from deepfracture.geometry import load_shape

    return lambda folder: load_shape(str(folder / name))


def _mesh(file: str) -> Reader:
    return Reader(file, file, _load(file), _meshes(file))


def _meshes(file: str) -> Callable[[Path], Sequence[Path]]:
    def write(folder: Path) -> Sequence[Path]:

        import trimesh

        part = plain.cube()
        tree, buffer = plain.gltf(part)
        whole = trimesh.Trimesh(*part, process=False)
        painted = trimesh.Trimesh(*part, process=False, vertex_colors=np.full((len(part[0]), 4), 99, np.uint8))
        kinds: dict[str, list[Any]] = {
            "mesh.obj": [plain.obj(part), (_cube(folder)[0] / "cube.obj").read_bytes()],
            "mesh.ply": [plain.ply(part), plain.ply_text(part), painted.export(file_type="ply")],
            "mesh.stl": [plain.stl(part), plain.stl_text(part)],
            "mesh.off": [plain.off(part)],
            "mesh.glb": [plain.glb(tree, buffer), painted.export(file_type="glb"), whole.export(file_type="glb")],
            "mesh.gltf": [json.dumps(tree | {"buffers": [{"uri": _base64(buffer), "byteLength": len(buffer)}]})],
        }
        places = []
        for number, content in enumerate(kinds[file]):
            place = folder / str(number)
            place.mkdir()
            (place / file).write_bytes(content.encode() if isinstance(content, str) else content)
            places.append(place)
        return places

    return write


def _base64(data: bytes) -> str:
    import base64

    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()


def _cube(folder: Path) -> Sequence[Path]:
    import runpy

    painted = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "tools" / "painted.py"))
    place = folder / "cube"
    place.mkdir()
    painted["write_cube"](place)
    return [place]


def _scene(kind: str) -> Callable[[Path], Any]:
    from deepfracture.world import load_scene

    return lambda folder: load_scene(folder / f"scene{kind}")


def _scenes(folder: Path) -> Sequence[Path]:
    from deepfracture.world import Ball, Block, Floor, Placed, Scene, save_scene

    scene = Scene(
        (Placed("pot", "plaster", repair=True), Placed("mesh.obj", "glass", (1.0, 0.0, 2.0))),
        (Ball(0.2, 7800.0, (3.0, 0.0, 1.0), (-9.0, 0.0, 0.5), 0.25),),
        Floor(),
        blocks=(Block((0.0, 0.0, 1.0), (0.5, 0.1, 0.1)),),
        breaker="physical",
        refracture=2,
    )
    for kind in (".toml", ".json"):
        save_scene(scene, folder / f"scene{kind}")
    return [folder]


def _model(folder: Path) -> Any:
    from deepfracture.learn import load_model

    return load_model(folder / "model.safetensors")


def _field_model(folder: Path) -> Any:
    from deepfracture.learn import load_model

    return load_model(folder / "field.safetensors", device="cpu")


def _checkpoint(folder: Path) -> Any:
    """Go on from it: what is damaged is refused, what is not of this run, too."""
    run = TRAINING["run"]
    run.load_checkpoint(folder / "run" / "checkpoint.safetensors")


TRAINING: dict[str, Any] = {}
"""A small training in this process, of which the checkpoints are."""


def _models(folder: Path) -> Sequence[Path]:
    """Small models of both kinds and the checkpoint of a training."""
    import runpy

    import torch

    from deepfracture.learn import PartitionConfig, PublishedConfig, TrainOptions, train
    from deepfracture.learn.distributed import DistributedContext
    from deepfracture.learn.partition.train_step import PartitionTrainStep
    from deepfracture.learn.training import Run

    torch.set_num_threads(1)
    made = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "unit" / "learn" / "test_training.py"))
    data = made["made"](folder / "data", 2)
    small = PartitionConfig(impulse_size=8, segment_size=4, hidden=8, basis=16, batch=2, points=50)
    options = TrainOptions(epochs=1, device="cpu")
    train(data, folder / "run", options, config=small)
    tiny = PublishedConfig("paper", 0.02, impulse_size=8, segment_size=4)
    train(data, folder / "field", options, config=tiny)
    shutil.move(folder / "run" / "model.safetensors", folder / "model.safetensors")
    shutil.move(folder / "field" / "model.safetensors", folder / "field.safetensors")
    context = DistributedContext(torch.device("cpu"))
    step = PartitionTrainStep(data, small, 0, context.device, folder / "run")
    TRAINING["run"] = Run(step, 0, context)
    return [folder]


def _info(file: str) -> Callable[[Path], Any]:
    from deepfracture.cli.info import info

    return lambda folder: info(str(folder / file))


def _reports(folder: Path) -> Sequence[Path]:
    stage = {"stage": "load", "seconds": 0.1, "peak_mb": 99.0}
    fragment = {"volume": 1.0, "mass": 2.0, "closed": True}
    report = {"shape": "pot", "breaker": "learned", "material": "plaster", "seed": 0, "broke": True, "impulse": 9.0,
              "sigma_1": 1e7, "strength": 2e7, "fragments": [fragment], "volume_error": 0.0, "stages": [stage],
              "files": ["a.glb"]}  # fmt: skip
    (folder / "report.json").write_text(json.dumps(report))
    return [folder]


def _dataset(folder: Path) -> Any:
    """Open it and read all that it says is there; what cannot be read may be named entry by entry."""
    from deepfracture.dataset import open_dataset

    data = open_dataset(folder / "data")
    return [data[index] for index in range(min(len(data), 4))], data.impacts()


def _datasets(folder: Path) -> Sequence[Path]:
    import runpy

    made = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "unit" / "learn" / "test_training.py"))
    made["made"](folder / "data", 2)
    return [folder]


def _elastic(folder: Path) -> Any:
    from deepfracture.fracture.elastostatics import ElasticBody

    return ElasticBody.load(folder / "body.elastic")


def _distances(folder: Path) -> Any:
    from deepfracture.fracture.cache import _load_array

    return _load_array(folder / "body.distances")


def _elastics(folder: Path) -> Sequence[Path]:
    import trimesh

    from deepfracture.fracture.cache import _save_array
    from deepfracture.fracture.elastostatics import prepare
    from deepfracture.types import Mesh

    ball = trimesh.creation.icosphere(0)
    prepare(Mesh(ball.vertices, ball.faces), 0.2).save(folder / "body.elastic")
    _save_array(np.zeros((4, 4, 4), np.float32), folder / "body.distances")
    return [folder]


# One reader, in a process of its own.

CHILD = """
import sys
sys.path.insert(0, sys.argv[1])
import fuzz
fuzz.work(*sys.argv[2:])
"""


class Case:
    """Mutated copies of the valid files of a reader, one after another, in one folder."""

    def __init__(self, reader: Reader, place: Path) -> None:
        self.reader, self.place = reader, place / "now"
        seeds = place / "seeds"
        seeds.mkdir(parents=True)
        self.folders = reader.seeds(seeds)
        self.files: list[tuple[Path, Path, bytes]] = []
        """Folder, file in it, and what is in that."""
        for folder in self.folders:
            names = [folder / reader.file] if "*" not in reader.file else sorted(folder.rglob(reader.file))
            names = [file for name in names for file in ([name] if name.is_file() else sorted(name.rglob("*")))]
            self.files += [(folder, file.relative_to(folder), file.read_bytes()) for file in names if file.is_file()]
        assert self.files, f"{reader.name}: nothing to begin with"
        assert all(len(content) < LARGEST for _, _, content in self.files), f"{reader.name}: too large to begin with"
        self.others = [content for _, _, content in self.files]
        for folder in self.folders:
            assert outcome(reader, folder) == "read"
        self.current = self.folders[0]
        shutil.copytree(self.current, self.place)

    def put(self, number: int, change: Callable[[bytes], bytes]) -> bytes:
        """Change one of the files; all others are as they should be."""
        folder, name, content = self.files[number % len(self.files)]
        if folder != self.current:
            shutil.rmtree(self.place)
            shutil.copytree(folder, self.place)
            self.current = folder
        data = change(content)
        (self.place / name).write_bytes(data)
        return data

    def restore(self, number: int) -> None:
        _, name, content = self.files[number % len(self.files)]
        (self.place / name).write_bytes(content)


@dataclass
class Found:
    """Something that should not be."""

    reader: str
    what: str
    where: str
    """In the code."""
    data: str
    """The file with the bytes."""


class TooLong(BaseException):
    """The time for one reading is over; no reader catches it."""


def _alarm(*_: Any) -> None:
    raise TooLong


def work(name: str, folder: str, time_left: str, number: str, engine: str) -> None:
    """Fuzz one reader in this process; what is found goes to the file `found` line by line, counts to `counts`."""
    reader, place, seconds, seed = readers()[name], Path(folder), float(time_left), int(number)
    logging.getLogger("deepfracture").setLevel(logging.CRITICAL)
    case = Case(reader, place)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.RLIM_INFINITY))
    signal.signal(signal.SIGALRM, _alarm)
    counts = {"read": 0, "refused": 0, "found": 0}
    seen: set[str] = set()
    end = time.monotonic() + seconds

    def one(number: int, change: Callable[[bytes], bytes]) -> None:
        data = case.put(number, change)
        (place / "last").write_bytes(data)
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        try:
            counts[outcome(reader, case.place)] += 1
        except (Exception, TooLong) as problem:
            signal.setitimer(signal.ITIMER_REAL, 0)
            counts["found"] += 1
            _note(reader, problem, data, place, seen)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        case.restore(number)
        if sum(counts.values()) % 100 == 0:
            (place / "counts").write_text(json.dumps(counts))
        if time.monotonic() > end:
            (place / "counts").write_text(json.dumps(counts))
            os._exit(0)

    if engine == "atheris":
        _steered(case, one, seconds, seed)
    rng = np.random.default_rng(seed)
    while True:
        moves = random_moves(rng)
        one(int(rng.integers(1 << 16)), lambda content, moves=moves: mutate(content, moves, case.others))


def _steered(case: Case, one: Callable[[int, Callable[[bytes], bytes]], None], seconds: float, seed: int) -> None:
    """By coverage: what libFuzzer mutates are the numbers of the file and of the moves."""
    import atheris  # pyright: ignore[reportMissingImports]

    def test(data: bytes) -> int:
        if len(data) < 8:  # no move: nothing to learn from
            return -1
        numbers = np.frombuffer(data[: len(data) // 2 * 2], "<u2").tolist()
        moves = [tuple(numbers[k : k + 3]) for k in range(1, len(numbers) - 2, 3)][:8]
        one(numbers[0], lambda content: mutate(content, moves, case.others))  # type: ignore[arg-type]
        return 0

    for name in WATCH:
        module = importlib.import_module(name)
        for function in [value for value in vars(module).values() if inspect.isfunction(value)]:
            if function.__module__.startswith(name):  # what numba has compiled is no function any more
                atheris.instrument_func(function)  # pyright: ignore[reportAttributeAccessIssue]
    rng = np.random.default_rng(seed)
    corpus = case.place.parent / "corpus"
    corpus.mkdir()
    for number in range(64):
        (corpus / str(number)).write_bytes(rng.integers(0, 1 << 16, 7, np.uint16).tobytes())
    atheris.Setup(
        [sys.argv[0], str(corpus), f"-seed={seed + 1}", "-max_len=64", "-rss_limit_mb=0", "-timeout=0",
         f"-max_total_time={int(seconds) + 60}", "-verbosity=0", "-print_final_stats=0"],
        test,  # pyright: ignore[reportArgumentType]
    )  # fmt: skip
    atheris.Fuzz()


def _note(reader: Reader, problem: BaseException, data: bytes, place: Path, seen: set[str]) -> None:
    frames = traceback.extract_tb(problem.__traceback__)
    ours = [frame for frame in frames if "deepfracture" in frame.filename] or frames
    where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
    what = f"{type(problem).__name__}: {(str(problem).splitlines() or [''])[0][:160]}"
    key = f"{type(problem).__name__} {where}"
    if key in seen:
        return
    seen.add(key)
    kept = place.parent / "findings" / f"{reader.name}-{hashlib.sha256(data).hexdigest()[:12]}"
    kept.parent.mkdir(exist_ok=True)
    kept.write_bytes(data)
    with open(place / "found", "a", encoding="utf-8") as file:
        file.write(json.dumps([reader.name, what, where, str(kept)]) + "\n")


# All of them.


def fuzz(
    minutes: float = 30.0, only: tuple[str, ...] = (), engine: str = "", seed: int = 0, log: Path | None = None,
    text: Path | None = None, keep: Path | None = None,
) -> None:  # fmt: skip
    """Fuzz all readers, each for the same share of the time.

    Args:
        minutes: in all.
        only: names of readers; all if not given.
        engine: atheris, or random; by default atheris where it is installed.
        seed: of the mutations.
        log: also write counts and findings to this file.
        text: also write the table to this file.
        keep: an empty folder to work in, which stays, with the bytes of what was found.
    """
    if not engine:
        from importlib.util import find_spec

        engine = "random" if find_spec("atheris") is None else "atheris"
    names = only or tuple(readers())
    base = (keep or Path(tempfile.mkdtemp(prefix="fuzz-"))).resolve()
    rows, logged = [], []
    for name in names:
        result = _one_reader(name, base, 60 * minutes / len(names), engine, seed)
        logged.append(result)
        rows.append((name, f"{result['cpu'] / 60:.1f}", *(result[key] for key in ("files", "read", "refused")),
                     result["crashes"], len(result["findings"])))  # fmt: skip
        sys.stderr.write(f"{json.dumps(result)}\n")
        if log is not None:
            write_json(log, {"engine": engine, "seed": seed, "readers": logged})
    shown = table(("reader", "minutes of a core", "files", "read", "refused", "crashes", "findings"), rows)
    sys.stdout.write(shown)
    if text is not None:
        write_text(text, shown)
    if keep is None:
        shutil.rmtree(base)


def _one_reader(name: str, base: Path, seconds: float, engine: str, seed: int) -> dict[str, Any]:
    """Processes, one after another where one dies, until the time is over."""
    begun, number, crashes, before = time.monotonic(), 0, 0, _cpu()
    counts = {"read": 0, "refused": 0, "found": 0}
    findings: dict[str, list[str]] = {}
    while (left := seconds - (time.monotonic() - begun)) > 1:
        place = base / f"{name}_{number}"
        place.mkdir(parents=True)
        command = [sys.executable, "-c", CHILD, str(Path(__file__).parent)]
        words = [name, str(place), str(left), str(seed + number), engine]
        with open(place / "said", "wb") as said:
            ended = subprocess.run([*command, *words], stdout=said, stderr=said)
        if (place / "counts").is_file():
            for key, value in json.loads((place / "counts").read_text()).items():
                counts[key] += value
        for line in (place / "found").read_text().splitlines() if (place / "found").is_file() else ():
            _, what, where, kept = json.loads(line)
            findings.setdefault(f"{what.split(':')[0]} {where}", [what, where, kept])
        if ended.returncode:
            crashes += 1
            said = (place / "said").read_text(errors="replace").splitlines()[-1:]
            kept = base / "findings" / f"{name}-crash-{number}"
            kept.parent.mkdir(exist_ok=True)
            if not (place / "last").is_file():
                raise BadInput(f"{name}: does not begin: {' '.join(said)}")
            shutil.copy(place / "last", kept)
            findings[f"status {ended.returncode}"] = [f"status {ended.returncode}: {said}", "", str(kept)]
        number += 1
        shutil.rmtree(place)
    took = {"seconds": time.monotonic() - begun, "cpu": _cpu() - before}
    counted = {"files": sum(counts.values()), **counts, "crashes": crashes}
    return {"name": name, **took, **counted, "findings": list(findings.values())}


def _cpu() -> float:
    """Seconds of a core that the processes have had."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    start(fuzz)
