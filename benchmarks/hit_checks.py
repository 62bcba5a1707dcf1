"""Random hits on many shapes by the fracture simulator, each pattern and its fragments checked.

For every hit: no crash; the pattern's labels fill the shape exactly and none is empty; its cracks do not leak (the cut
gives at least as many fragments as the pattern has labels); every fragment is closed, manifold and of positive
volume; their volumes add up to the mesh's. Degenerate meshes are cases of their own. Every shape runs in its own
process, so that one that dies takes nothing with it; finished hits are kept in --out and not repeated (use another
folder once the simulator has changed).
"""

from __future__ import annotations

import json
import os
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from degenerate import DEGENERATE
from harness import DATA, ROOT, SPEEDS, kept, mesh_files, start, table, throw, write_json, write_text

from deepfracture.carve import cut
from deepfracture.carve.cutting.cut import SMALLEST_VOXELS
from deepfracture.fracture import FractureBody, material, prepare_body, simulate
from deepfracture.geometry import BUILTIN, load_shape, mesh_defects, signed_distance
from deepfracture.geometry.topology import split_pinches
from deepfracture.runtime.parallel import ONE_THREAD
from deepfracture.runtime.progress import log, track
from deepfracture.types import BadInput, FracturePattern, Fragments, Grid, Shape

ON_SURFACE = 1e-6
"""A voxel centre nearer to the surface than this may count as either side [m]: float32 noise at unit scale."""
VOLUME_TOLERANCE = 2e-3
"""Of the sum of the fragments' volumes against the mesh's."""
HEAD = ("shape", "faces", "hits", "broke", "fragments min/median/max", "worst volume error", "s median/max", "failures")


def hit_checks(
    shapes: tuple[str, ...] = (),
    hits: int = 20,
    resolution: int = 64,
    preset: str = "plaster",
    speed: tuple[float, float] = SPEEDS,
    workers: int = 2,
    seed: int = 0,
    data: Path = DATA,
    out: Path = ROOT / "runs" / "hit_checks",
) -> Path:
    """Hit every shape at random and check what comes of it; writes hit_checks.json and hit_checks.md into --out.

    Args:
        shapes: only these cases: built-in names, file stems of --data, degenerate cases; all if none is named.
        hits: per shape.
        resolution: voxels along each axis.
        preset: the whole-material preset.
        speed: slowest and fastest ball [m/s].
        workers: shapes at a time.
        seed: of the hits and the material.
        data: folder of meshes; those that are not closed must be refused in one line.
        out: folder of finished hits and of the tables.
    """
    sources = cases(data)
    if unknown := set(shapes) - set(sources):
        raise BadInput(f"shapes: no case is called {min(unknown)!r}; choose from {', '.join(sources)}")
    names = list(shapes or sources)
    folder = out / f"{preset}-r{resolution}-{speed[0]:g}-{speed[1]:g}-s{seed}"
    os.environ.update(ONE_THREAD)  # read by the processes that start from here
    with ThreadPoolExecutor(workers) as pool:
        jobs = [pool.submit(_apart, name, folder, hits, resolution, preset, speed, seed, data) for name in names]
        for job in track(as_completed(jobs), name="shapes", total=len(jobs)):
            job.result()
    rows = {name: _read(folder / name, hits) for name in names}
    write_json(out / "hit_checks.json", rows)
    text = summary(rows, hits)
    write_text(out / "hit_checks.md", text)
    log.warning("%s", text)
    return out / "hit_checks.json"


def cases(data: Path) -> dict[str, Callable[[], Shape]]:
    """What makes each shape: built in, degenerate, and every mesh file of the folder `data`."""
    made: dict[str, Callable[[], Shape]] = {name: lambda name=name: load_shape(name) for name in BUILTIN}
    made.update(DEGENERATE)
    made.update({name: lambda path=path: load_shape(str(path)) for name, path in mesh_files(data).items()})
    return made


def run_case(
    name: str, folder: Path, hits: int, resolution: int, preset: str, speed: tuple[float, float], seed: int, data: Path
) -> None:
    """All hits on one shape that the folder does not hold yet; one JSON file a hit, `body.json` for the shape."""
    rows = [folder / name / f"{number:03d}.json" for number in range(hits)]
    if all(path.is_file() for path in rows):
        return
    begin = time.perf_counter()
    try:
        shape = cases(data)[name]()
        body = prepare_body(shape, material(preset), Grid(resolution))
    except BadInput as refusal:
        write_json(folder / name / "body.json", {"refused": str(refusal).replace(f"{data}{os.sep}", "")})
        return
    except Exception:  # what a crash looks like is what this program is here to tell
        write_json(folder / name / "body.json", {"crash": traceback.format_exc()})
        return
    seconds = time.perf_counter() - begin
    write_json(folder / name / "body.json", {"faces": len(shape.mesh.faces), "seconds": seconds})
    inside = signed_distance(shape.mesh, body.grid)
    for number, path in enumerate(rows):
        kept(path, lambda number=number: check_hit(body, inside, number, seed=seed, speed=speed))


def check_hit(
    body: FractureBody, inside: np.ndarray, number: int, *, seed: int, speed: tuple[float, float]
) -> dict[str, Any]:
    """One random hit: its figures, and what is wrong with the outcome (`failures`, empty if nothing).

    `inside`: signed distance of the voxel centres [m], positive inside, shape (r, r, r)."""
    row: dict[str, Any] = {"number": number, "fragments": 1, "labels": 1, "failures": []}
    begin = time.perf_counter()
    try:
        hit = throw(body.shape, body.material, number, seed=seed, speed=speed)
        row |= {"seed": hit.seed, "impulse": float(hit.impact.magnitude[0]), "speed": hit.impact.speed}
        begin = time.perf_counter()
        cracking = simulate(body, hit.impact, hit.rng)
        row["seconds"] = time.perf_counter() - begin
        if cracking is None:
            return row
        row |= {"cracks": cracking.cracks, "labels": cracking.pattern.count}
        row["failures"] += pattern_failures(cracking.pattern, inside)
        pieces = cut(body.shape, cracking.pattern, density=body.material.density)
        error = pieces.volume / body.shape.mesh.volume - 1
        smallest = min(piece.volume for piece in pieces) / body.grid.spacing**3
        row |= {"fragments": len(pieces), "volume_error": error, "smallest_voxels": smallest}
        row["failures"] += fragment_failures(body.shape, cracking.pattern, pieces)
    except Exception as crash:  # what a crash looks like is what this program is here to tell
        row.setdefault("seconds", time.perf_counter() - begin)
        row["failures"].append(f"crash: {type(crash).__name__}: {str(crash).splitlines()[0] if str(crash) else ''}")
        row["traceback"] = traceback.format_exc()
    return row


def pattern_failures(pattern: FracturePattern, inside: np.ndarray) -> list[str]:
    """What is wrong with a pattern; `inside` as in `check_hit`."""
    labels = pattern.labels
    empty = int((labels == 0)[inside > ON_SURFACE].sum())
    beyond = int((labels > 0)[inside < -ON_SURFACE].sum())
    sizes = np.bincount(labels.ravel())[1:]
    found = [
        (empty, f"{empty} voxels inside without a label"),
        (beyond, f"{beyond} labelled voxels outside"),
        ((sizes == 0).any(), f"{(sizes == 0).sum()} empty labels"),
        (_specks(sizes), f"{_specks(sizes)} labels of fewer than {SMALLEST_VOXELS} voxels, which no fragment can have"),
        (pattern.count < 2, "a crack pattern of one label"),
    ]
    return [text for wrong, text in found if wrong]


def fragment_failures(shape: Shape, pattern: FracturePattern, pieces: Fragments) -> list[str]:
    """What is wrong with the fragments that were cut out of a shape along a pattern."""
    error = abs(pieces.volume / shape.mesh.volume - 1)
    torn = [n for n, piece in enumerate(pieces) if not mesh_defects(piece.mesh).closed]
    pinched = [n for n, p in enumerate(pieces) if len(split_pinches(p.mesh).vertices) != len(np.unique(p.mesh.faces))]
    void = [n for n, piece in enumerate(pieces) if not piece.volume > 0]
    whole = pattern.count - _specks(np.bincount(pattern.labels.ravel())[1:])
    found = [
        (error > VOLUME_TOLERANCE, f"volumes off by {error:.2%}"),
        (torn, f"{len(torn)} fragments not closed"),
        (pinched, f"{len(pinched)} fragments pinched at a vertex"),
        (void, f"{len(void)} fragments without volume"),
        (len(pieces) < 2, "called broken, yet in one piece"),
        (len(pieces) < whole, f"leak: {whole} labels, {len(pieces)} fragments"),
    ]
    return [text for wrong, text in found if wrong]


def _specks(sizes: np.ndarray) -> int:
    """Labels too small for `cut` to make a fragment of; `sizes` in voxels."""
    return int(((sizes > 0) & (sizes < SMALLEST_VOXELS)).sum())


def summary(rows: dict[str, dict[str, Any]], hits: int) -> str:
    """The table by shape, and under it every failure with its seed."""
    lines, failures = [], []
    for name, case in rows.items():
        done, body = case["hits"], case["body"]
        if "refused" in body or "crash" in body:
            last = body.get("refused") or body["crash"].strip().splitlines()[-1]
            lines.append((name, "", 0, 0, "", "", "", ("refused: " if "refused" in body else "CRASH: ") + last))
            continue
        wrong = [row for row in done if row["failures"]]
        for row in wrong:
            failures += [f"- {name} hit {row['number']} (seed {row.get('seed')}): {what}" for what in row["failures"]]
        if len(done) < hits:
            failures.append(f"- {name}: only {len(done)} of {hits} hits, its process died ({case['exit']})")
        broke = [row for row in done if row["fragments"] > 1]
        counts = [row["fragments"] for row in broke] or [1]
        seconds = [row["seconds"] for row in done] or [0.0]
        error = max((abs(row.get("volume_error", 0.0)) for row in done), default=0.0)
        lines.append(
            (
                name, body["faces"], len(done), len(broke), f"{min(counts)} / {np.median(counts):g} / {max(counts)}",
                f"{error:.1e}", f"{np.median(seconds):.1f} / {max(seconds):.1f}", len(wrong) + hits - len(done),
            )
        )  # fmt: skip
    return table(HEAD, lines) + ("\nFailures:\n\n" + "\n".join(failures) if failures else "\nNo failure.") + "\n"


def _apart(name: str, folder: Path, *args: Any) -> None:
    """`run_case` in a process of its own; how that ended is kept beside its rows."""
    process = get_context("spawn").Process(target=run_case, args=(name, folder, *args))
    process.start()
    process.join()
    write_json(folder / name / "exit.json", process.exitcode)


def _read(folder: Path, hits: int) -> dict[str, Any]:
    read = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))}
    done = [read[f"{number:03d}"] for number in range(hits) if f"{number:03d}" in read]
    died = {"crash": f"the process died ({read['exit']}) before the first hit"}
    return {"body": read.get("body", died), "exit": read["exit"], "hits": done}


if __name__ == "__main__":
    start(hit_checks)
