"""Table of docs/reports/crash_safety.md: kill -9 at random moments of simulate, train, shatter and of saving in play.

    python benchmarks/crash_safety.py --kills 100 --text crash_safety.md

Each command is run undisturbed once. Then it is killed again and again, each time at a moment drawn evenly from the
time that it took, every second time with all its processes, else its first process alone. After each kill

- everything that lies under a final name is byte for byte what some finished run wrote there (checkpoints, which no
  finished run leaves in that state, are read back),
- the same command, started again, ends well by itself,
- and leaves what the undisturbed run left, byte for byte, and nothing else: no temporary file in its folder, none where
  the system keeps temporary files.

What is killed is the command itself, in a process that has loaded the program already: else most moments would fall
into the start of Python. Times of the clock in train's curve and card are set to zero, and those in report.json are
left out, as they differ between any two runs.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from harness import start, table, write_json, write_text

from deepfracture.cli import main

Digests = dict[str, str]
"""Of files, by their names in a folder."""
HIDDEN = ".deepfracture"
"""How the names of temporary files and locks begin."""
OTHERS = ("torchinductor_", "pymp-")
"""How the names of folders begin that libraries keep for temporary files and that are not ours: torch's cache."""
LONGEST = 300.0
"""Seconds that a run may take before it counts as hanging."""


@dataclass(frozen=True)
class Job:
    """A command that is killed."""

    name: str
    run: Callable[[Path], None]
    """Does the work, in a folder that is given."""
    before: Callable[[Path], None] = lambda folder: None
    """What lies in the folder at the start."""
    whole: Callable[[Path, Digests, Digests], str] = lambda folder, before, after: _either(folder, before, after)
    """What a kill left, in a word: "nothing new", "part", "all"; AssertionError if that is not as it should be."""


@dataclass
class Tally:
    """What came of the kills."""

    kills: int = 0
    late: int = 0
    """Runs that had ended before the signal came."""
    left: dict[str, int] = field(default_factory=dict)
    """How often a kill left nothing new, a part, or all."""
    litter: int = 0
    """Kills after which temporary files lay about, before the next start."""
    faults: list[str] = field(default_factory=list)


def kill_all(
    jobs: tuple[str, ...] = ("simulate", "train", "shatter", "play"), kills: int = 100, seed: int = 0,
    json_file: Path | None = None, text: Path | None = None, keep: Path | None = None,
) -> None:  # fmt: skip
    """Kill each of the jobs so often, and say what came of it.

    Args:
        jobs: simulate, train, train-paper, shatter or play.
        kills: of each job.
        seed: of the moments.
        json_file: also write the figures to this file.
        text: also write the table to this file.
        keep: an empty folder to work in, which stays.
    """
    import numba

    numba.config.THREADING_LAYER = "workqueue"  # pyright: ignore  (the only one that lives through a fork)
    rows, figures = [], []
    with place_of(keep) as place:
        known = make_jobs(place)
        for name in jobs:
            begun = time.monotonic()
            took, tally = kill_often(known[name], place / name, kills, np.random.default_rng(seed))
            left = [tally.left.get(kind, 0) for kind in ("nothing new", "part", "all")]
            rows.append((name, tally.kills, f"{took:.1f}", *left, tally.litter, len(tally.faults)))
            figures.append({"job": name, "seconds": took, **vars(tally), "minutes": (time.monotonic() - begun) / 60})
            sys.stderr.write(f"{figures[-1]}\n")
    head = ("killed", "times", "s undisturbed", "left nothing new", "left a part", "left all", "swept", "faults")
    shown = table(head, rows)
    sys.stdout.write(shown)
    if json_file is not None:
        write_json(json_file, figures)
    if text is not None:
        write_text(text, shown)


@contextmanager
def place_of(keep: Path | None) -> Iterator[Path]:
    if keep is not None:
        yield keep.resolve()
        return
    with tempfile.TemporaryDirectory(prefix="kills-") as place:
        yield Path(place)


def kill_often(job: Job, place: Path, kills: int, rng: np.random.Generator) -> tuple[float, Tally]:
    """Seconds of an undisturbed run, and what came of the kills."""
    original, tally, took = place / "original", Tally(), 0.0
    original.mkdir(parents=True)
    job.before(original)
    before = digests(original)
    shutil.copytree(original, place / "first")
    with _inside(place / "first"):
        job.run(place / "first")  # in this process, so that all is compiled and loaded before it forks
    shutil.copytree(original, place / "calm")
    took = wait(begin(job, place / "calm"), LONGEST)
    after = digests(place / "calm")
    _as_if_undisturbed(place / "first", after)
    assert not litter(place / "calm"), "an undisturbed run leaves litter"
    for number in range(kills):
        folder, moment = place / f"kill_{number:03d}", float(rng.uniform(0, took))
        shutil.copytree(original, folder)
        child = begin(job, folder)
        time.sleep(moment)
        group = number % 2 == 0
        tally.kills += 1
        tally.late += not kill(child, group=group)
        try:
            left = job.whole(folder, before, after)
            tally.left[left] = tally.left.get(left, 0) + 1
            tally.litter += bool(litter(folder))
            wait(begin(job, folder), LONGEST)
            _as_if_undisturbed(folder, after)
        except AssertionError as fault:
            tally.faults.append(f"kill {number} after {moment:.3f} s, {'group' if group else 'parent'}: {fault}")
            sys.stderr.write(f"{job.name}: {tally.faults[-1]}\n")
            continue  # and the folder stays, to be looked at
        shutil.rmtree(folder)
        if (number + 1) % 10 == 0:
            sys.stderr.write(f"{job.name}, {took:.1f} s: {vars(tally)}\n")
    return took, tally


# Processes.


def begin(job: Job, folder: Path) -> int:
    """The job in a process and a group of its own, which has all that this one has loaded."""
    sys.stderr.flush()
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        os.setsid()
        out = os.open(folder.with_name(f"{folder.name}.log"), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(out, 1)
        os.dup2(out, 2)
        with _inside(folder):
            job.run(folder)
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def wait(child: int, longest: float) -> float:
    """Seconds until the process ended; AssertionError unless it ended well."""
    begun = time.monotonic()
    while time.monotonic() - begun < longest:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            assert status == 0, f"status {os.waitstatus_to_exitcode(status)}"
            return time.monotonic() - begun
        time.sleep(0.002)
    kill(child, group=True)
    raise AssertionError(f"hangs for {longest:.0f} s")


def kill(child: int, *, group: bool) -> bool:
    """kill -9; whether it was still alive. Of a parent killed alone, wait until all of its children have ended."""
    if os.waitpid(child, os.WNOHANG)[0]:
        return False
    (os.killpg if group else os.kill)(child, signal.SIGKILL)
    os.waitpid(child, 0)
    begun = time.monotonic()
    while _alive(child):
        assert time.monotonic() - begun < 60, "children live on for a minute"
        time.sleep(0.05)
    return True


def _alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """What a run finds: its folder, and one for temporary files."""
    temporary = folder.with_name(f"{folder.name}_tmp")
    temporary.mkdir(exist_ok=True)
    former = Path.cwd(), os.environ.get("TMPDIR")
    tempfile.tempdir = os.environ["TMPDIR"] = str(temporary)
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(former[0])
        tempfile.tempdir = None
        os.environ.pop("TMPDIR")
        if former[1] is not None:
            os.environ["TMPDIR"] = former[1]


# What lies in a folder.


def digests(folder: Path) -> Digests:
    """Of all files but hidden ones."""
    return {
        name: hashlib.sha256(_lasting(file)).hexdigest()[:16]
        for file in sorted(folder.rglob("*"))
        if file.is_file() and HIDDEN not in (name := str(file.relative_to(folder)))
    }


def _lasting(file: Path) -> bytes:
    """What a file holds, but times of the clock."""
    data = file.read_bytes()
    if file.name != "report.json":
        return data
    report = json.loads(data)
    return json.dumps({key: value for key, value in report.items() if key != "stages"}).encode()


def litter(folder: Path) -> list[str]:
    """What is hidden in the folder, and what is left where its runs keep temporary files."""
    temporary = folder.with_name(f"{folder.name}_tmp")
    hidden = [str(path) for path in folder.rglob("*") if HIDDEN in path.name or path.name.startswith(".")]
    return hidden + [str(path) for path in temporary.iterdir() if not path.name.startswith(OTHERS)]


def _either(folder: Path, before: Digests, after: Digests) -> str:
    """Each file is as it was, or as it will be."""
    now = digests(folder)
    for name, digest in now.items():
        assert digest in (before.get(name), after.get(name)), f"{name} is neither as it was nor as it will be"
    for name in before:
        assert name in now or name not in after, f"{name} is lost"
    return "nothing new" if now == before else "all" if now == after else "part"


def _as_if_undisturbed(folder: Path, after: Digests) -> None:
    now = digests(folder)
    assert now == after, f"differs from an undisturbed run: {sorted(set(now.items()) ^ set(after.items()))[:4]}"
    assert not litter(folder), f"litter: {litter(folder)[:4]}"


# The jobs.


def make_jobs(place: Path) -> dict[str, Job]:
    """The jobs by name; what they need beside is made in `place` when it is first asked for."""
    data = place / "data"

    def dataset(folder: Path) -> None:
        if not data.is_dir():
            wait(begin(Job("data", lambda _: _simulate(data, 4)), folder), LONGEST)

    return {
        "simulate": Job("simulate", lambda folder: _simulate(folder / "data", 4), whole=_samples),
        "train": Job("train", lambda folder: _train(data, folder / "run", "waves"), dataset, _run),
        "train-paper": Job("train-paper", lambda folder: _train(data, folder / "run", "paper"), dataset, _run),
        "shatter": Job("shatter", _shatter, _shattered, _result),
        "play": Job("play", _play),
    }


def _simulate(folder: Path, collisions: int) -> None:
    size = ["--resolution", "32", "--collisions", str(collisions), "--workers", "1"]
    main(["-q", "simulate", "bar", "--out", str(folder), *size])


def _train(data: Path, out: Path, preset: str) -> None:
    import torch

    from deepfracture.learn import training

    torch.set_num_threads(1)
    training.CHECKPOINT_SECONDS = 0.0  # a checkpoint after each epoch
    clock = SimpleNamespace(perf_counter=lambda: 0.0, monotonic=time.monotonic)
    training.time = clock  # pyright: ignore[reportAttributeAccessIssue]
    size = [] if preset == "waves" else ["--preset", preset, "--width", "0.125"]
    main(["-q", "train", str(data), "--out", str(out), "--epochs", "40" if preset == "waves" else "6", *size])


def _run(folder: Path, before: Digests, after: Digests) -> str:
    """A run folder: the checkpoint of any epoch, and final files as they will be."""
    from deepfracture.learn.checkpoint import read

    now, name = digests(folder), "run/checkpoint.safetensors"
    if name in now:
        kinds = []
        for kind in ("training checkpoint", "field training checkpoint"):
            try:
                kinds.append(read(folder / name, kind)[1]["progress"]["epoch"])
            except ValueError:
                continue
        assert kinds, "the checkpoint cannot be read"
    for other in now:
        assert other == name or now[other] == after.get(other), f"{other} is not as it will be"
    return "nothing new" if not now else "all" if now == after else "part"


SCENE = """
duration = 0.2
breaker = "learned"
[floor]
[[shapes]]
shape = "pot"
material = "plaster"
position = [0.0, 0.0, 1.0]
[[balls]]
radius = 0.2
density = 7800.0
position = [{x}, 0.0, 1.1]
velocity = [{v}, 0.0, 0.5]
"""
FORMATS = ("page", "glb", "film", "fragments", "usdz", "ply-sequence")


def _shatter(folder: Path) -> None:
    (folder.with_name(f"{folder.name}.toml")).write_text(SCENE.format(x=1.6, v=-15.0))
    scene = str(folder.with_name(f"{folder.name}.toml"))
    main(["-q", "shatter", "--scene", scene, "--out", str(folder / "out"), "--formats", *FORMATS])


def _shattered(folder: Path) -> None:
    """The folder holds what another scene gave."""
    scene = folder.with_name("other.toml")
    scene.write_text(SCENE.format(x=-1.7, v=12.0))
    words = ["-q", "shatter", "--scene", str(scene), "--out", str(folder / "out"), "--formats", *FORMATS]
    wait(begin(Job("other", lambda _: main(words)), folder), LONGEST)
    read_back(folder / "out")


def read_back(out: Path) -> None:
    """Read all that shatter wrote, by the libraries that its users have."""
    import trimesh
    from pxr import Usd

    from deepfracture.geometry import read_mesh
    from deepfracture.world import load_scene

    assert json.loads((out / "report.json").read_text())["broke"]
    assert trimesh.load_scene(out / "animation.glb").geometry
    assert (out / "animation.html").read_text().rstrip().endswith("</html>")
    assert (out / "animation.mp4").read_bytes()[4:8] == b"ftyp"
    for fragment in (out / "fragments").iterdir():
        read_mesh(fragment)
    assert Usd.Stage.Open(str(out / "animation.usdz"))  # pyright: ignore[reportAttributeAccessIssue]
    assert all(trimesh.load_mesh(frame).faces.size for frame in (out / "ply_sequence").iterdir())
    load_scene(out / "scene.toml")


def _result(folder: Path, before: Digests, after: Digests) -> str:
    """The result of one run as a whole, or, between the moment in which the new one begins to move in and that in
    which it has, none: then there is no report."""
    found = _mixed(folder, before, after)
    if (folder / "out" / "report.json").exists():
        assert found != "part", "a mixture of two runs that has a report"
    return found


def _mixed(folder: Path, before: Digests, after: Digests) -> str:
    now = digests(folder)
    for name, digest in now.items():
        assert digest in (before.get(name), after.get(name)), f"{name} is of neither run"
    old = {name for name in now if now[name] != after.get(name)}
    stale = {name for name in before if name not in after}
    return "nothing new" if now == before else "all" if old <= stale and set(after) <= set(now) else "part"


def _play(folder: Path) -> None:
    """The page, a world in it with a mesh that was dropped onto it, and each file that a player can take home."""
    from deepfracture.geometry import load_shape
    from deepfracture.play.breaker_cache import BreakerCache
    from deepfracture.play.saving import FILES, make_file
    from deepfracture.play.server import Options, page
    from deepfracture.play.session import Session, Setup, Shot
    from deepfracture.play.uploads import read_upload

    shape = load_shape("bar").mesh
    mesh = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in shape.vertices.tolist())
    mesh += "".join(f"f {a} {b} {c}\n" for a, b, c in (shape.faces + 1).tolist())
    with page(Options("bar", port=0)):
        own = next(Path(tempfile.gettempdir()).glob(f"{HIDDEN}-*/new")) / "tab_0"
        entry = read_upload(mesh.encode(), "bar.obj", own, limit=1 << 20)
        session = Session(BreakerCache(), entry, Setup("voronoi"))
        session.shoot(np.array([3.0, 0.1, 0.5]), np.array([-1.0, 0.0, 0.0]), Shot())
        while session.frames < 25 and session.step():
            pass
        for kind in FILES:
            name, content = make_file(kind, session.recording(), session.scene(), entry)
            kept = folder / name
            if name.endswith(".zip"):
                content = _unpacked(content)
            kept.with_name(f"{HIDDEN}-browser").write_bytes(content)  # it is the browser that keeps what it is given
            os.replace(kept.with_name(f"{HIDDEN}-browser"), kept)
        session.close()


def _unpacked(data: bytes) -> bytes:
    """What is in a zip, without the dates."""
    import io
    import zipfile

    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        return b"".join(name.encode() + packed.read(name) for name in packed.namelist())


def _samples(folder: Path, before: Digests, after: Digests) -> str:
    """A data set: what is there is as it will be; what the program opens, it can read."""
    from deepfracture.dataset import open_dataset

    found = _either(folder, before, after)
    if any((folder / "data" / "entries").glob("*.json")):  # before the first one its mesh may not be there yet
        for sample in open_dataset(folder / "data"):
            assert sample.pattern.count > 1
    return found


if __name__ == "__main__":
    start(kill_all)
