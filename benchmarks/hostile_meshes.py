"""Writes docs/reports/hostile_meshes.md: each mesh is broken correctly, repaired and broken, or refused with a reason.

Each case is written to a file, loaded as it is and with repair, and broken by the Voronoi breaker on a coarse grid, in
a process of its own that is stopped where it takes too long or too much memory. docs/reports/hostile_meshes.md
is the table."""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from harness import ROOT, start, table, write_text
from hostile_files import File, files, ply
from hostile_solids import cube, solids

from deepfracture.breakers import BreakerOptions, make_breaker
from deepfracture.fracture import material
from deepfracture.geometry import load_shape
from deepfracture.geometry.intersect import self_intersections
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, Grid, Impact, NoSolution, Shape
from deepfracture.validation.fragments import check_fragments

MEMORY = 6 << 30
"""Bytes of address space that a case may take."""
SECONDS = 60
"""Processor time [s] that a case may take: loading, breaking and checking, each twice."""
PATIENCE = 15
"""Times as long that it may take by the clock, on a busy machine."""
GRID = Grid(32)
MATERIAL = "plaster"
IMPULSE = 3000.0
"""[N s]; breaks everything."""
FAILED = "FAILED"


@dataclass(frozen=True)
class Outcome:
    """What became of one case, loaded in one way."""

    kind: str
    """"broken", "refused" or FAILED."""
    note: str
    """How many fragments, the refusal, or what went wrong."""
    seconds: float = 0.0
    """Processor time of both ways together."""
    memory: int = 0
    """Greatest resident size [bytes] of the process, which has the program itself in it."""
    warned: bool = False
    """Whether the log had a warning."""


def cases() -> Iterator[File]:
    """Every case: class, name, and what writes its file into a folder."""

    def writes(make: Callable[[], Any]) -> Callable[[Path], Path]:
        def write(folder: Path) -> Path:
            path = folder / "mesh.ply"
            path.write_bytes(ply(make()))
            return path

        return write

    for kind, name, make in solids():
        yield kind, name, writes(make)
    yield from files()


def hit(shape: Shape) -> Impact:
    """A blow from above on the highest face that looks up."""
    areas = shape.mesh.area_vectors
    sizes = np.linalg.norm(areas, axis=1)
    up = areas[:, 2] > 0.5 * np.maximum(sizes, 1e-300)
    height = np.where(up, shape.mesh.triangles[:, :, 2].mean(axis=1), -np.inf)
    face = int(height.argmax()) if up.any() else int(sizes.argmax())
    normal = areas[face] / sizes[face]
    place = shape.mesh.triangles[face].mean(axis=0)
    return Impact(place[None], -normal[None], np.array([IMPULSE]), normal[None], speed=20.0, radius=0.2)


def break_both(path: Path) -> Iterator[Outcome]:
    """What becomes of the mesh in a file, as it is and with repair."""
    plain: Shape | None = None
    for repair in (False, True):
        try:
            shape = load_shape(str(path), repair=repair)
            if plain is not None and repair and _same(plain, shape):
                yield Outcome("same", "as without")
                continue
            plain = shape
            yield break_one(shape)
        except (BadInput, NoSolution) as refusal:
            lines = str(refusal).splitlines()
            fine = len(lines) == 1 and "Traceback" not in lines[0] and len(lines[0]) < 400
            yield Outcome("refused" if fine else FAILED, " / ".join(lines).replace(str(path), path.name))


def _same(one: Shape, other: Shape) -> bool:
    pairs = ((one.mesh.vertices, other.mesh.vertices), (one.mesh.faces, other.mesh.faces))
    return all(np.array_equal(a, b) for a, b in pairs)


def break_one(shape: Shape) -> Outcome:
    """Break a shape, and check every fragment. A refusal is an exception."""
    breaker = make_breaker("voronoi", shape, material(MATERIAL), BreakerOptions(resolution=GRID.resolution))
    fragments = breaker(shape, hit(shape), np.random.default_rng(0))
    if fragments is None:
        return Outcome(FAILED, "withstood the blow")
    wrong = dict(check_fragments(shape, fragments, voxel=GRID.spacing).failures)
    if "crossing" in wrong and len(self_intersections(shape.mesh)):
        # What crossed before does so still, as loading has warned.
        del wrong["crossing"]
        return Outcome(FAILED if wrong else "broken", f"{len(fragments)} fragments, crossing as the mesh did")
    return Outcome(FAILED if wrong else "broken", f"{len(fragments)} fragments" + f", wrong: {wrong}" * bool(wrong))


def guarded(
    work: Callable[[], Iterator[Outcome]], *, seconds: int = SECONDS, memory: int = MEMORY
) -> tuple[Outcome, Outcome]:
    """The two outcomes of `work`, in a process of its own, within limits; whatever it does, this returns."""
    read, write = os.pipe()
    begin = time.perf_counter()
    child = os.fork()
    if not child:
        os.close(read)
        _in_child(work, write, seconds, memory)
    os.close(write)
    data, said = b"", ""
    with os.fdopen(read, "rb") as pipe:
        while True:
            left = begin + PATIENCE * seconds - time.perf_counter()
            if not select.select([pipe], [], [], max(0, left))[0]:
                os.kill(child, signal.SIGKILL)
                said = f"stood still for {PATIENCE * seconds} s"
                break
            piece = os.read(pipe.fileno(), 1 << 16)
            if not piece:
                break
            data += piece
    _, status, used = os.wait4(child, 0)
    if os.WIFSIGNALED(status) and not said:
        number = os.WTERMSIG(status)
        said = f"took longer than {seconds} s" if number == signal.SIGXCPU else f"was ended by signal {number}"
    took = {"seconds": used.ru_utime + used.ru_stime, "memory": used.ru_maxrss * 1024}
    found = [Outcome(**json.loads(line) | took) for line in data.splitlines()]
    found += [Outcome(FAILED, said or "said nothing", **took)] * (2 - len(found))
    plain, mended = found[:2]
    return plain, replace(plain, warned=mended.warned) if mended.kind == "same" else mended


def _in_child(work: Callable[[], Iterator[Outcome]], write: int, seconds: int, memory: int) -> NoReturn:
    import logging
    import traceback
    import warnings

    warned: list[str] = []

    class Ear(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            warned.append(record.getMessage())

    def say(outcome: Outcome) -> None:
        told = {"kind": outcome.kind, "note": outcome.note.replace("\n", " / ")[:2000], "warned": bool(warned)}
        os.write(write, json.dumps(told).encode() + b"\n")
        warned.clear()

    log.handlers = [Ear(logging.WARNING)]
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    try:
        for outcome in work():
            say(outcome)
    except BaseException as problem:
        last = traceback.extract_tb(problem.__traceback__)[-1]
        where = f"{Path(last.filename).name}:{last.lineno}"
        say(Outcome(FAILED, f"{type(problem).__name__} at {where}: {str(problem)[:200]}"))
    os._exit(0)


def judged(write: Callable[[Path], Path]) -> tuple[Outcome, Outcome]:
    """What becomes of a case as it is, and with repair."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder))
        return guarded(lambda: break_both(path))


def one_thread() -> None:
    """Numba in threads that survive a fork, and warm: to be called before anything else works."""
    import numba

    numba.config.THREADING_LAYER = "workqueue"  # type: ignore[attr-defined]
    numba.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.ply"
        path.write_bytes(ply(cube()))
        for _ in break_both(path):
            pass


def verdict(plain: Outcome, mended: Outcome) -> str:
    """The class of a case in the table."""
    if FAILED in (plain.kind, mended.kind):
        return FAILED
    if plain.kind == "broken":
        return "broken"
    return "repaired, then broken" if mended.kind == "broken" else "refused"


def run(
    out: Path = ROOT / "docs" / "reports" / "hostile_meshes.md", only: str = "", log_to: Path | None = None
) -> None:
    """Judge every case and write the table.

    Args:
        out: The Markdown file.
        only: Cases whose class or name holds this alone; nothing is written then.
        log_to: A file of all outcomes, JSON, one a line. What it holds already is not judged again.
    """
    found: list[tuple[str, str, Outcome, Outcome]] = []
    known = _logged(log_to)
    one_thread()
    for kind, name, write in cases():
        if only not in f"{kind}: {name}":
            continue
        if (kind, name) in known:
            found.append((kind, name, *known[kind, name]))
            continue
        plain, mended = judged(write)
        found.append((kind, name, plain, mended))
        sys.stdout.write(f"{verdict(plain, mended):20s} {kind}: {name}\n    as it is: {_told(plain)}\n")
        sys.stdout.write(f"    mended:   {_told(mended)}\n")
        sys.stdout.flush()
        if log_to is not None:
            with open(log_to, "a", encoding="utf-8") as file:
                file.write(json.dumps([kind, name, asdict(plain), asdict(mended)]) + "\n")
    if not only:
        write_text(out, report(found))
    if any(verdict(plain, mended) == FAILED for _, _, plain, mended in found):
        sys.exit(1)


def _logged(path: Path | None) -> dict[tuple[str, str], tuple[Outcome, Outcome]]:
    if path is None or not path.exists():
        return {}
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return {(kind, name): (Outcome(**plain), Outcome(**mended)) for kind, name, plain, mended in lines}


def _told(outcome: Outcome) -> str:
    return f"{outcome.kind}: {outcome.note} ({outcome.seconds:.1f} s, {outcome.memory >> 20} MB)"


def report(found: list[tuple[str, str, Outcome, Outcome]]) -> str:
    """The page."""
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    for kind, _, plain, mended in found:
        kinds[kind][verdict(plain, mended)] += 1
    columns = ("broken", "repaired, then broken", "refused", FAILED)
    total: Counter[str] = Counter()
    rows = []
    for kind, counts in kinds.items():
        own = [o for k, _, plain, mended in found if k == kind for o in (plain, mended)]
        slowest, largest = max(o.seconds for o in own), max(o.memory for o in own)
        rows.append([kind, counts.total(), *(counts[c] or "" for c in columns), f"{slowest:.1f}", largest >> 20])
        total += counts
    rows.append(["**all**", total.total(), *(total[c] for c in columns), "", ""])
    head = ["class", "cases", *columns[:3], "crashed, hung or wrong", "slowest [s]", "most memory [MB]"]
    about = []
    for kind in kinds:
        about += [f"\n### {kind[0].upper()}{kind[1:]}\n\n"]
        lines = [
            [name, verdict(p, m), _cell(p), "" if p.kind == "broken" else _cell(m)]
            for k, name, p, m in found
            if k == kind
        ]
        about += [table(["case", "outcome", "as it is", "with `--repair`"], lines)]
    return (
        "# Hostile meshes\n\n"
        f"`benchmarks/hostile_meshes.py` makes {total.total()} hostile meshes and mesh files, and\n"
        "loads and breaks each twice, as it is and with `--repair`: Voronoi breaker, 32 voxels, all fragments checked\n"
        "(closed, manifold, one body, outward, volumes add up, original surface unchanged). Each runs in a\n"
        f"process of its own limited to {MEMORY >> 30} GB and {SECONDS} s of CPU time. *Refused* means one line that\n"
        "says what is wrong and what to do.\n\n" + table(head, rows) + "\n## Every case\n" + "".join(about)
    )


def _cell(outcome: Outcome) -> str:
    note = outcome.note.replace("|", "\\|").replace("<", "&lt;").replace("`", "'")
    return note if outcome.kind == "broken" else f"{outcome.kind}: {note}"


if __name__ == "__main__":
    start(run)
