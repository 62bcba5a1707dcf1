"""Atomic writes: files and folders appear complete or not at all, even if the process is killed or the disk is full.

Output is written into a scratch folder beside its destination, `.deepfracture-XXXXXXXX`, which holds a locked file.
The lock ends with the process: the next writer to the same place removes the scratch folders that are not locked."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from deepfracture.runtime.lock import acquire, release
from deepfracture.types import BadInput

PREFIX = ".deepfracture-"
LOCK = "lock"
NEW, FORMER = "new", "former"
"""Subfolders of a scratch folder: the output being written, and what it replaces."""
ADVICE = {
    errno.ENOSPC: "the disk is full; free some space or use another folder, and rerun",
    errno.EDQUOT: "the disk quota is exceeded; free some space or use another folder, and rerun",
    errno.EFBIG: "the file exceeds the size limit; raise it (ulimit -f) or use another folder",
    errno.EIO: "the disk reports an error; use another folder",
    errno.EROFS: "that disk is read-only; use another folder",
    errno.EACCES: "permission denied; change its permissions or use another folder",
    errno.EPERM: "the system does not permit it; use another folder",
    errno.ENOTDIR: "a part of this path is a file, not a folder; use another folder",
    errno.EEXIST: "a file is in the way; use another folder",
    errno.EISDIR: "a folder is in the way; use another name",
    errno.ENAMETOOLONG: "the name is too long; use a shorter one",
}
"""What to do when a file cannot be written, by errno."""
PROBE_BYTES = 1 << 16
"""Written after a failure of another kind, to tell whether the disk is full."""


def explain_write_error(problem: OSError) -> str | None:
    """One line: the file, the cause and the remedy. None for errors that are not about writing files."""
    if problem.errno not in ADVICE or problem.filename is None:
        return None
    return f"{problem.filename}: {ADVICE[problem.errno]}"


@contextmanager
def atomic_file(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary file of the same name, which replaces `path` when the block succeeds.

    OSError names `path` where it cannot be written."""
    path = Path(path)
    with _errors_name(path), _scratch_beside(path) as folder:
        with _detect_full_disk(folder):
            yield folder / path.name
            _sync(folder / path.name)
        os.replace(folder / path.name, path)


@contextmanager
def atomic_folder(folder: str | os.PathLike) -> Iterator[Path]:
    """A temporary folder of the same name, which replaces `folder` and all its content when the block succeeds.

    OSError names `folder` where it cannot be written."""
    folder = Path(folder)
    with _errors_name(folder), _scratch_beside(folder) as temporary:
        new = temporary / folder.name
        with _detect_full_disk(temporary):
            new.mkdir()
            yield new
            _sync(new)
        _replace(new, folder)


@contextmanager
def atomic_contents(folder: str | os.PathLike, *, last: str) -> Iterator[Path]:
    """A temporary folder whose content moves into `folder` when the block succeeds; other files there are kept.

    last: the commit marker: the file that is moved last, and whose former version is removed first. Where it exists,
    everything written with it exists."""
    folder = Path(folder)
    with _errors_name(folder / last), _scratch_beside(folder / last) as temporary:
        with _detect_full_disk(temporary):
            yield temporary
            _sync(temporary)
        names = sorted(entry.name for entry in temporary.iterdir())
        (folder / last).unlink(missing_ok=True)
        for name in [*(name for name in names if name != last), last]:
            _replace(temporary / name, folder / name)


@contextmanager
def scratch_folder(parent: str | os.PathLike | None = None) -> Iterator[Path]:
    """An empty folder in `parent` (None: the system's temporary folder), removed at the end of the block.

    Folders of killed processes are removed first."""
    parent = Path(tempfile.gettempdir() if parent is None else parent)
    remove_stale(parent)
    folder, handle = _claim(parent)
    try:
        (folder / NEW).mkdir()
        yield folder / NEW
    finally:
        for name in (NEW, FORMER):
            shutil.rmtree(folder / name, ignore_errors=True)
        release(handle, folder / LOCK)
        shutil.rmtree(folder, ignore_errors=True)


def remove_stale(folder: Path) -> None:
    """Remove the scratch folders that killed processes left in `folder`, and restore what they were replacing."""
    for left in folder.glob(f"{PREFIX}*"):
        try:
            if left.is_symlink() or (os.name != "nt" and left.lstat().st_uid != os.getuid()):
                continue
            handle = acquire(left / LOCK, create=False)
        except FileNotFoundError:  # killed before it had a lock, or about to create one
            _remove_if_empty(left)
            continue
        except OSError:
            continue  # another user's
        if handle is None:
            continue
        try:
            linked = (left / FORMER).is_symlink()  # then it is not ours
            for former in () if linked else (left / FORMER).glob("*"):
                if not (folder / former.name).exists():
                    os.replace(former, folder / former.name)
            for name in (NEW, FORMER):
                shutil.rmtree(left / name, ignore_errors=True)
        finally:
            release(handle, left / LOCK)
            _remove_if_empty(left)


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):  # not empty, or gone
        folder.rmdir()


@contextmanager
def _scratch_beside(path: Path) -> Iterator[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    with scratch_folder(path.parent) as folder:
        yield folder


def _claim(parent: Path) -> tuple[Path, int]:
    """A new scratch folder and its lock."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        try:
            handle = acquire(folder / LOCK)
        except FileNotFoundError:  # another process removed it as stale
            continue
        except OSError:
            _remove_if_empty(folder)
            raise
        if handle is not None:
            return folder, handle


def _replace(new: Path, place: Path) -> None:
    """Move a file or folder out of a scratch folder to its place, and a folder that it replaces into the scratch."""
    if not (new.is_dir() and os.path.lexists(place)):
        os.replace(new, place)
        return
    if _exchange(new, place):
        return
    former = new.parent.parent / FORMER
    former.mkdir(exist_ok=True)
    os.replace(place, former / place.name)  # `remove_stale` repairs a kill between the two
    os.replace(new, place)


def _exchange(one: Path, other: Path) -> bool:
    """Swap two names atomically, where the system can: Linux, on most file systems."""
    if not sys.platform.startswith("linux"):
        return False
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    here, exchange = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of linux/fs.h
    return call is not None and call(here, os.fsencode(one), here, os.fsencode(other), exchange) == 0


def _sync(path: Path) -> None:
    """Flush a file, or all files of a folder, to the disk: a power cut leaves no name without its content."""
    for file in path.rglob("*") if path.is_dir() else [path]:
        if file.is_file():
            with open(file, "rb+") as opened:
                os.fsync(opened.fileno())


@contextmanager
def _errors_name(path: Path) -> Iterator[None]:
    """Report errors about temporary files as errors about `path`."""
    try:
        yield
    except OSError as problem:
        name = problem.filename
        inside = name is None or PREFIX in str(name) or Path(os.fsdecode(name)) == path.parent
        if problem.errno in ADVICE and inside:
            raise OSError(problem.errno, problem.strerror, str(path)) from problem
        raise


@contextmanager
def _detect_full_disk(folder: Path) -> Iterator[None]:
    """Raise the OSError of a full disk in place of another failure: encoders and libraries do not report it as such."""
    try:
        yield
    except BadInput:
        raise
    except Exception as problem:
        if not (isinstance(problem, OSError) and problem.errno in ADVICE):
            with open(folder / "probe", "wb") as file:
                file.write(bytes(PROBE_BYTES))
                file.flush()
                os.fsync(file.fileno())
        raise
