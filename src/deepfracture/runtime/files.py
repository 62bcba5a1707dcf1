"""Files and folders that appear whole or not at all, whenever the process is killed and however full the disk is.

What is being written lies in a scratch folder beside its place, `.deepfracture-XXXXXXXX`, with a locked file in it.
The lock goes with the process: whoever writes to the same place next sweeps the scratch folders that nobody holds."""

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
"""Folders in a scratch folder: what is being written, and what it has just taken the place of."""
ADVICE = {
    errno.ENOSPC: "the disk is full; free some space or use another folder, and run again",
    errno.EDQUOT: "your share of the disk is used up; free some space or use another folder, and run again",
    errno.EFBIG: "it would be larger than files may be here; raise that limit (ulimit -f) or use another folder",
    errno.EIO: "the disk reports an error; use another folder",
    errno.EROFS: "that disk is read-only; use another folder",
    errno.EACCES: "permission denied; change its permissions or use another folder",
    errno.EPERM: "the system does not permit it; use another folder",
    errno.ENOTDIR: "a part of this path is a file, not a folder; use another folder",
    errno.EEXIST: "a file is in the way; use another folder",
    errno.EISDIR: "a folder is in the way; use another name",
    errno.ENAMETOOLONG: "the name is too long; use a shorter one",
}
"""What can be done where a file cannot be written, by the number of the error."""
PROBE = 1 << 16
"""Bytes that have to fit where something failed for another reason than a full disk."""


def explain_write_error(problem: OSError) -> str | None:
    """One line: which file, what is wrong, what to do. None for errors that are not about writing files."""
    if problem.errno not in ADVICE or problem.filename is None:
        return None
    return f"{problem.filename}: {ADVICE[problem.errno]}"


@contextmanager
def atomic_file(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary file of the same name, moved onto `path` when the block ends well.

    OSError names `path` where it cannot be written."""
    path = Path(path)
    with _named(path), _beside(path) as folder:
        with _probed(folder):
            yield folder / path.name
            _sync(folder / path.name)
        os.replace(folder / path.name, path)


@contextmanager
def atomic_folder(folder: str | os.PathLike) -> Iterator[Path]:
    """A temporary folder of the same name, moved into the place of `folder` when the block ends well.

    A former `folder` is dropped with all that is in it. OSError names `folder` where it cannot be written."""
    folder = Path(folder)
    with _named(folder), _beside(folder) as temporary:
        fresh = temporary / folder.name
        with _probed(temporary):
            fresh.mkdir()
            yield fresh
            _sync(fresh)
        _put(fresh, folder)


@contextmanager
def atomic_contents(folder: str | os.PathLike, *, last: str) -> Iterator[Path]:
    """A temporary folder, the content of which moves into `folder` when the block ends well.

    last: the file that goes there last; a former one is removed before the first. So wherever it is, all that
    came with it is there, too. What else is in `folder` stays."""
    folder = Path(folder)
    with _named(folder / last), _beside(folder / last) as temporary:
        with _probed(temporary):
            yield temporary
            _sync(temporary)
        names = sorted(entry.name for entry in temporary.iterdir())
        (folder / last).unlink(missing_ok=True)
        for name in [*(name for name in names if name != last), last]:
            _put(temporary / name, folder / name)


@contextmanager
def scratch_folder(parent: str | os.PathLike | None = None) -> Iterator[Path]:
    """An empty folder in `parent` (None: where the system keeps temporary files), which goes with the block.

    Those of processes that were killed are swept first."""
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
    """Remove what killed processes left in `folder`, and put back what they had moved out of its place."""
    for left in folder.glob(f"{PREFIX}*"):
        try:
            if left.is_symlink() or (os.name != "nt" and left.lstat().st_uid != os.getuid()):
                continue
            handle = acquire(left / LOCK, make=False)
        except FileNotFoundError:  # killed before there was a lock, or just about to make one
            _remove_if_empty(left)
            continue
        except OSError:
            continue  # somebody else's
        if handle is None:
            continue
        try:
            linked = (left / FORMER).is_symlink()  # then it is no work of ours
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
def _beside(path: Path) -> Iterator[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    with scratch_folder(path.parent) as folder:
        yield folder


def _claim(parent: Path) -> tuple[Path, int]:
    """A new scratch folder and its lock."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        try:
            handle = acquire(folder / LOCK)
        except FileNotFoundError:  # another process took it for a leftover
            continue
        except OSError:
            _remove_if_empty(folder)
            raise
        if handle is not None:
            return folder, handle


def _put(fresh: Path, place: Path) -> None:
    """Move a file or folder of a scratch folder into its place, and what has been there into the scratch folder."""
    if not (fresh.is_dir() and os.path.lexists(place)):
        os.replace(fresh, place)
        return
    if _exchange(fresh, place):
        return
    former = fresh.parent.parent / FORMER
    former.mkdir(exist_ok=True)
    os.replace(place, former / place.name)  # a kill here is repaired by `remove_stale`
    os.replace(fresh, place)


def _exchange(one: Path, other: Path) -> bool:
    """Swap two names at once, where the system can: Linux, on most file systems."""
    if not sys.platform.startswith("linux"):
        return False
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    here, exchange = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of linux/fs.h
    return call is not None and call(here, os.fsencode(one), here, os.fsencode(other), exchange) == 0


def _sync(path: Path) -> None:
    """Bring a file, or all files of a folder, to the disk, so that not even a power cut leaves a name without them."""
    for file in path.rglob("*") if path.is_dir() else [path]:
        if file.is_file():
            with open(file, "rb+") as opened:
                os.fsync(opened.fileno())


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Errors about temporary files are errors about `path`."""
    try:
        yield
    except OSError as problem:
        name = problem.filename
        inside = name is None or PREFIX in str(name) or Path(os.fsdecode(name)) == path.parent
        if problem.errno in ADVICE and inside:
            raise OSError(problem.errno, problem.strerror, str(path)) from problem
        raise


@contextmanager
def _probed(folder: Path) -> Iterator[None]:
    """Where something fails in another way than with an OSError of the system, see if the disk is the reason: what
    encoders and libraries say when it is full has nothing to do with it."""
    try:
        yield
    except BadInput:
        raise
    except Exception as problem:
        if not (isinstance(problem, OSError) and problem.errno in ADVICE):
            with open(folder / "probe", "wb") as file:
                file.write(bytes(PROBE))
                file.flush()
                os.fsync(file.fileno())
        raise
