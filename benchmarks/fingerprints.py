"""Compares two versions of the program: SHA-256 of everything that it writes, as equal seeds must give equal bytes.

    python benchmarks/fingerprints.py --out before.json      # with the one version on PYTHONPATH, or installed
    python benchmarks/fingerprints.py --out after.json       # with the other; then compare the two files

Five shapes with each breaker, data sets, two trainings, and a recording in every format."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from harness import ROOT, start, write_json

from deepfracture.runtime.progress import log
from deepfracture.types import BadInput

SHAPES = ("pot", "mug", "bunny", "base", "chair")
BREAKERS = ("learned", "physical", "voronoi", "cvd", "nearest", "random")
VARYING = ("stages", "files", "seconds", "machine")
"""Entries of report.json that differ from run to run."""
PROGRAM = "import sys; from deepfracture.cli import main; sys.exit(main())"
Keep = Callable[[str, Path], None]


def fingerprints(
    only: tuple[str, ...] = (), work: Path = ROOT / "runs" / "fingerprints", out: Path = Path("fingerprints.json")
) -> None:
    """Run the parts and write their digests to `out`, which other parts may fill already.

    Args:
        only: parts to run, of data, train, shatter and recording; default: all. The later ones read the data sets.
        work: folder of what the program writes; an empty one for each version.
        out: JSON file of the digests.
    """
    unknown = set(only) - PARTS.keys()
    if unknown:
        raise BadInput(f"only must be some of {', '.join(PARTS)}, got {', '.join(sorted(unknown))}")
    found = json.loads(out.read_text()) if out.exists() else {}

    def keep(name: str, path: Path) -> None:
        files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
        digests = {str(file.relative_to(path if path.is_dir() else path.parent)): digest(file) for file in files}
        merged = hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()
        found[name] = {"all": merged, "files": digests}
        write_json(out, dict(sorted(found.items())))
        log.warning("%s: %s (%d files)", name, merged[:16], len(digests))

    work.mkdir(parents=True, exist_ok=True)
    for part in only or PARTS:
        PARTS[part](work, keep)


def digest(path: Path) -> str:
    """SHA-256 of a file, without what varies from run to run."""
    data = path.read_bytes()
    if path.name == "report.json":
        report = {key: value for key, value in json.loads(data).items() if key not in VARYING}
        data = json.dumps(report, sort_keys=True).encode()
    return hashlib.sha256(data).hexdigest()


def run(work: Path, command: str) -> None:
    """Run a command of the program in the folder `work`."""
    done = subprocess.run([sys.executable, "-c", PROGRAM, *command.split()], cwd=work, capture_output=True, text=True)
    if done.returncode:
        raise BadInput(f"{command}: status {done.returncode}\n{done.stderr[-2000:]}")


def data(work: Path, keep: Keep) -> None:
    for shape in SHAPES:
        run(
            work,
            f"simulate {shape} --out data/{shape} --collisions 6 --resolution 32 --speed 10 25 --workers 2 --seed 5",
        )
        keep(f"data {shape}", work / "data" / shape)
    run(
        work,
        "simulate pot --out data/pot_dual --collisions 2 --resolution 32 --speed 15 30 --scene dual --refracture 1 "
        "--seed 6",
    )
    keep("data pot dual refracture", work / "data" / "pot_dual")


def train(work: Path, keep: Keep) -> None:
    run(work, "train data/pot --out train/waves --epochs 4")
    run(work, "train data/pot --out train/paper --preset paper --width 0.1 --epochs 2")
    for kind, folder, name, speed in (("waves", "own", "own", 15), ("paper", "ownpaper", "own paper", 20)):
        model = f"train/{kind}/model.safetensors"
        keep(f"train {kind}", work / model)
        run(work, f"shatter pot --model {model} --out out/{folder} --no-film --speed {speed} --formats glb fragments")
        keep(f"shatter pot {name} model", work / "out" / folder)


def shatter(work: Path, keep: Keep) -> None:
    for breaker in BREAKERS:
        for shape in SHAPES:
            if breaker == "learned" and shape == "chair":  # no model of it ships
                continue
            more = f"--dataset data/{shape}" if breaker in ("nearest", "random") else ""
            folder = f"out/{breaker}_{shape}"
            run(
                work,
                f"shatter {shape} --breaker {breaker} {more} --speed 15 --seed 1 --resolution 64 --out {folder} "
                "--formats glb fragments usda",
            )
            keep(f"shatter {breaker} {shape}", work / folder)
    run(
        work,
        "shatter pot --breaker physical --speed 15 --resolution 128 --budget 400 --roughness 0.01 --out out/fine "
        "--formats glb fragments",
    )
    keep("shatter physical pot 128 coarse cracks", work / "out" / "fine")


def recording(work: Path, keep: Keep) -> None:
    run(
        work,
        "shatter mug --breaker voronoi --speed 12 --out out/all --formats page glb picture film fragments usd usda "
        "obj-sequence ply-sequence",
    )
    keep("recording", work / "out" / "all")
    run(
        work,
        "shatter mug --breaker voronoi --speed 12 --engine bullet --out out/bullet --formats glb fragments",
    )
    keep("recording bullet", work / "out" / "bullet")


PARTS = {"data": data, "train": train, "shatter": shatter, "recording": recording}


if __name__ == "__main__":
    start(fingerprints)
