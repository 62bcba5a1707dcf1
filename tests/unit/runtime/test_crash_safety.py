"""Killed, full, read-only, two at once: what was finished stays, what was not leaves no trace."""

from __future__ import annotations

import errno
import multiprocessing
import os
import resource
import runpy
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepfracture.cli import main
from deepfracture.export import write_fragments, write_glb, write_sequence, write_usd
from deepfracture.learn.checkpoint import write
from deepfracture.render import write_film
from deepfracture.runtime import files, lock
from deepfracture.runtime.files import atomic_contents, atomic_file, atomic_folder, explain_write_error, scratch_folder
from deepfracture.runtime.lock import exclusive
from deepfracture.types import BadInput, Shape
from deepfracture.world import Placed, Scene, save_scene

tools = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "recordings.py"))
fork = multiprocessing.get_context("fork")


def killed(job: Callable[[], object]) -> None:
    """Run a job that ends its own process by kill -9."""
    child = fork.Process(target=job)
    child.start()
    child.join(20)
    assert child.exitcode == -signal.SIGKILL


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_killed_writer_leaves_the_former_file_and_the_next_one_sweeps(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def half() -> None:
        with atomic_file(path) as temporary:
            temporary.write_text("ha")
            die()

    killed(half)
    assert path.read_text() == "old"
    assert len(names(tmp_path)) == 2
    with atomic_file(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


def test_a_killed_writer_leaves_the_former_folder(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    folder.mkdir()
    (folder / "kept").write_text("old")

    def half() -> None:
        with atomic_folder(folder) as temporary:
            (temporary / "new").write_text("ha")
            die()

    killed(half)
    assert names(folder) == ["kept"]
    with atomic_folder(folder) as temporary:
        (temporary / "new").write_text("whole")
    assert names(folder) == ["new"] and names(tmp_path) == ["d"]


def test_where_folders_cannot_be_swapped_at_once_a_killed_one_is_put_back(tmp_path: Path, monkeypatch) -> None:
    """The moment between moving the former one away and the new one in."""
    folder = tmp_path / "d"
    folder.mkdir()
    (folder / "kept").write_text("old")
    monkeypatch.setattr(files, "_exchange", lambda one, other: False)
    move = os.replace

    def half() -> None:
        monkeypatch.setattr(os, "replace", lambda one, other: die() if Path(other) == folder else move(one, other))
        with atomic_folder(folder) as temporary:
            (temporary / "new").write_text("whole")

    killed(half)
    assert not folder.exists()
    files.remove_stale(tmp_path)
    assert names(folder) == ["kept"] and names(tmp_path) == ["d"]
    with atomic_folder(folder) as temporary:
        (temporary / "new").write_text("whole")
    assert names(folder) == ["new"] and names(tmp_path) == ["d"]


def test_what_a_living_process_writes_is_not_swept(tmp_path: Path) -> None:
    with atomic_file(tmp_path / "a.txt") as temporary:
        temporary.write_text("mine")
        child = fork.Process(target=files.remove_stale, args=(tmp_path,))
        child.start()
        child.join(20)
        files.remove_stale(tmp_path)
    assert (tmp_path / "a.txt").read_text() == "mine"


@pytest.mark.parametrize("when", ["before the lock", "with an empty lock"])
def test_a_process_killed_while_it_made_its_folder_is_swept_too(tmp_path: Path, when: str) -> None:
    left = tmp_path / f"{files.PREFIX}abc"
    left.mkdir()
    if when == "with an empty lock":
        (left / files.LOCK).touch()
    with scratch_folder(tmp_path):
        pass
    assert not names(tmp_path)


def test_a_link_that_is_called_like_a_leftover_is_let_be(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    (precious / files.NEW).mkdir(parents=True)
    (precious / files.NEW / "file").write_text("dear")
    (precious / files.LOCK).touch()
    (tmp_path / f"{files.PREFIX}link").symlink_to(precious)
    files.remove_stale(tmp_path)
    assert (precious / files.NEW / "file").read_text() == "dear"


def test_a_folder_is_filled_with_the_last_file_last(tmp_path: Path, monkeypatch) -> None:
    for name in ("a", "z", "report"):
        (tmp_path / name).write_text("old")
    order: list[str] = []
    move = os.replace

    def moved(one: Path, other: Path) -> None:
        order.append(Path(other).name)
        assert not (tmp_path / "report").exists()
        move(one, other)

    monkeypatch.setattr(os, "replace", moved)
    with atomic_contents(tmp_path, last="report") as temporary:
        for name in ("report", "a", "b"):
            (temporary / name).write_text("new")
        assert (tmp_path / "a").read_text() == (tmp_path / "report").read_text() == "old"
    assert order == ["a", "b", "report"]
    assert [(tmp_path / name).read_text() for name in names(tmp_path)] == ["new", "new", "new", "old"]


def test_a_failure_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "report").write_text("old")
    with pytest.raises(RuntimeError), atomic_contents(tmp_path, last="report") as temporary:
        (temporary / "report").write_text("new")
        raise RuntimeError
    assert names(tmp_path) == ["report"] and (tmp_path / "report").read_text() == "old"


# Two at once.


def test_the_second_process_is_refused_in_one_line_and_the_third_may(tmp_path: Path) -> None:
    def second() -> None:
        try:
            with exclusive(tmp_path):
                os._exit(0)
        except BadInput as refused:
            assert "\n" not in str(refused) and str(os.getppid()) in str(refused)
            os._exit(2)

    for expected in (2, 0):
        child = fork.Process(target=second)
        if expected == 2:
            with exclusive(tmp_path):
                child.start()
                child.join(20)
        else:
            child.start()
            child.join(20)
        assert child.exitcode == expected


def test_the_lock_of_a_dead_process_does_not_hold(tmp_path: Path) -> None:
    def dies() -> None:
        with exclusive(tmp_path):
            die()

    killed(dies)
    assert names(tmp_path) == [lock.LOCK_FILE]
    with exclusive(tmp_path):
        pass
    assert not names(tmp_path)


def test_many_processes_take_turns_and_none_is_in_at_once(tmp_path: Path) -> None:
    """Each opens, locks, removes: a lock on a file that has just been removed must not count."""

    def turns() -> None:
        done = 0
        while done < 40:
            try:
                with exclusive(tmp_path / "d"):
                    handle = os.open(tmp_path / "in", os.O_CREAT | os.O_EXCL)  # fails if another one is in
                    os.close(handle)
                    os.unlink(tmp_path / "in")
                    done += 1
            except BadInput:
                continue

    children = [fork.Process(target=turns) for _ in range(3)]
    for child in children:
        child.start()
    for child in children:
        child.join(60)
    assert [child.exitcode for child in children] == [0, 0, 0]


def test_two_threads_are_two(tmp_path: Path) -> None:
    with exclusive(tmp_path), pytest.raises(BadInput, match="writing"), exclusive(tmp_path):
        pass


@pytest.mark.parametrize("words", [("shatter", "bar", "--breaker", "voronoi", "--out"), ("train", "data", "--out")])
def test_commands_refuse_a_folder_that_another_one_is_at(words: tuple[str, ...], tmp_path: Path, capsys) -> None:
    if words[0] == "train":
        pytest.importorskip("torch")
        words = ("train", str(dataset(tmp_path / "data")), "--epochs", "1", "--out")
    with exclusive(tmp_path / "out"), pytest.raises(SystemExit) as ended:
        main([*words, str(tmp_path / "out")])
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("another process") == 1
    assert not (tmp_path / "out").exists() or not names(tmp_path / "out")


# Full, read-only, in the way.


@contextmanager
def files_end_at(size: int) -> Iterator[None]:
    """No file of this process may become larger than `size` [bytes], as on a disk that is nearly full."""
    former = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, former[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, former)
        signal.signal(signal.SIGXFSZ, before)


def writers() -> dict[str, Callable[[Path], object]]:
    """Everything that the program writes, by the name of its file."""
    recording = tools["broken_octahedron"]()
    fragments, shape = tools["halves"](), Shape("octahedron", tools["octahedron"]())
    return {
        "a.glb": lambda path: write_glb(recording, path),
        "a.usdc": lambda path: write_usd(recording, path),
        "a.usdz": lambda path: write_usd(recording, path),
        "a.mp4": lambda path: write_film(recording, path, size=(64, 48)),
        "fragments": lambda path: write_fragments(fragments, shape, path),
        "ply": lambda path: write_sequence(recording, path, kind="ply"),
        "a.safetensors": lambda path: write(path, "thing", {"a": np.zeros(1000)}, {}),
        "a.toml": lambda path: save_scene(Scene((Placed("pot", "plaster"),) * 20), path),
    }


@pytest.mark.parametrize("name", list(writers()))
def test_a_full_disk_ends_in_one_line_and_keeps_what_was_there(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    write_it = writers()[name]
    write_it(path)
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    with files_end_at(400), pytest.raises(OSError) as problem:
        write_it(path)
    assert problem.value.errno == errno.EFBIG
    line = explain_write_error(problem.value)
    assert line is not None and line.startswith(f"{path}: ") and "\n" not in line
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize("number", sorted(files.ADVICE))
def test_each_reason_names_the_file_and_what_to_do(number: int, tmp_path: Path) -> None:
    with pytest.raises(OSError) as problem, atomic_file(tmp_path / "a"):
        raise OSError(number, os.strerror(number))
    line = explain_write_error(problem.value)
    assert line is not None and str(tmp_path / "a") in line and "use" in line
    assert not names(tmp_path)


def test_errors_that_are_not_about_the_disk_stay_what_they_are(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), atomic_file(tmp_path / "a"):
        raise ZeroDivisionError
    with pytest.raises(FileNotFoundError), atomic_file(tmp_path / "a"):
        (tmp_path / "absent").read_text()
    assert not names(tmp_path)


def out_of_reach(folder: Path, kind: str) -> Path:
    """A folder that cannot be made."""
    if kind == "through a file":
        (folder / "file").touch()
        return folder / "file" / "out"
    (folder / "file").touch()
    return folder / "file"


def commands(folder: Path, out: Path) -> dict[str, list[str]]:
    return {
        "shatter": ["shatter", "bar", "--breaker", "voronoi", "--out", str(out)],
        "train": ["train", str(folder / "data"), "--epochs", "1", "--out", str(out)],
        "export-onnx": ["export-onnx", "pot", "--out", str(out / "pot.onnx")],
    }


@pytest.mark.parametrize("kind", ["through a file", "over a file"])
@pytest.mark.parametrize("command", ["shatter", "train", "export-onnx"])
def test_a_path_that_cannot_be_ends_in_one_line(command: str, kind: str, tmp_path: Path, capsys) -> None:
    if command == "train":
        pytest.importorskip("torch")
        dataset(tmp_path / "data")
    if command == "export-onnx":
        pytest.importorskip("onnx")
    out = out_of_reach(tmp_path, kind)
    with pytest.raises(SystemExit) as ended:
        main(["-q", *commands(tmp_path, out)[command]])
    assert ended.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert str(tmp_path / "file") in line and "use another folder" in line
    assert (tmp_path / "file").read_bytes() == b""


@pytest.mark.skipif(os.name == "nt" or not hasattr(os, "geteuid"), reason="needs users")
def test_a_read_only_folder_ends_in_one_line(tmp_path: Path) -> None:
    """As an ordinary user: root may write anywhere."""
    (tmp_path / "kept").write_text("old")
    tmp_path.chmod(0o555)

    def write_there(writer: Callable[[], Any], named: Path) -> None:
        if os.geteuid() == 0:
            os.seteuid(65534)
        try:
            with writer() as temporary:
                temporary.write_text("new")
        except OSError as problem:
            line = explain_write_error(problem) or ""
            os._exit(7 if line.startswith(f"{named}: ") and "permission denied" in line else 8)
        os._exit(9)

    for case in (
        (lambda: atomic_file(tmp_path / "kept"), tmp_path / "kept"),
        (lambda: exclusive(tmp_path), tmp_path),
    ):
        child = fork.Process(target=write_there, args=case)
        child.start()
        child.join(20)
        assert child.exitcode == 7
    tmp_path.chmod(0o755)
    assert (tmp_path / "kept").read_text() == "old" and names(tmp_path) == ["kept"]


def test_shatter_on_a_full_disk_keeps_the_former_result(tmp_path: Path) -> None:
    words = ["-q", "shatter", "bar", "--breaker", "voronoi", "--formats", "glb", "fragments", "--out", str(tmp_path)]
    main(words)
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    code = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000));"
    code += f"from deepfracture.cli import main; main({[*words, '--seed', '3']!r})"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 1
    (line,) = ended.stderr.splitlines()
    assert str(tmp_path) in line and "use another folder" in line
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


def test_simulate_on_a_full_disk_ends_like_every_other_command(tmp_path: Path) -> None:
    (tmp_path / "in the way").write_text("")
    words = ["-q", "simulate", "bar", "--collisions", "1", "--resolution", "32", "--out"]
    for out, limit in ((tmp_path / "set", 100), (tmp_path / "in the way" / "set", resource.RLIM_INFINITY)):
        code = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}));"
        code += f"from deepfracture.cli import main; main({[*words, str(out)]!r})"
        ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert ended.returncode == 1
        (line,) = ended.stderr.splitlines()
        assert str(tmp_path) in line and "use another folder" in line


def dataset(folder: Path) -> Path:
    """A data set of two patterns."""
    made = runpy.run_path(str(Path(__file__).parents[1] / "learn" / "test_training.py"))["made"]
    return made(folder, 2).path
