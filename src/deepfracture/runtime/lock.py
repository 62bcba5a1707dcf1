"""One process at a time: locks that the operating system drops with the process that holds them."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from deepfracture.runtime.progress import log
from deepfracture.types import BadInput

NAME = ".deepfracture.lock"
LOCKLESS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""What file systems without locks answer."""
PLACE = 1 << 30
"""Byte that is locked on Windows, where a locked one cannot be read: far behind what the file says."""


@contextmanager
def exclusive(folder: str | os.PathLike) -> Iterator[None]:
    """Write to `folder`, as the only process that asks so. It is made where it is not there, and goes again if nothing
    is written to it.

    Raises:
        BadInput: Another process is at it.
    """
    folder = Path(folder)
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    path = folder / NAME
    with _about(folder):
        while True:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                handle = acquire(path)
                break
            except (FileExistsError, FileNotFoundError):  # another process has removed it meanwhile
                if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
                    raise
    if handle is None:
        raise BadInput(f"{folder}: {_owner(path)} is writing to it; wait until it has ended, or use another folder")
    try:
        with _about(folder):
            os.write(handle, str(os.getpid()).encode())
        yield
    finally:
        release(handle, path)
        with suppress(OSError):  # something has been written
            for place in made:
                place.rmdir()


def acquire(path: Path, *, make: bool = True) -> int | None:
    """A lock on the file `path`, to be given back by `release`; None if somebody holds it, in whatever process.

    make: whether the file is made where it is not there; else FileNotFoundError. On file systems that know no
    locks the file is taken as it is, with a warning, if it had to be made, and else left alone."""
    flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | (os.O_CREAT if make else 0)
    while True:
        handle = os.open(path, flags, 0o666)
        try:
            mine = _lock(handle)
        except OSError as problem:
            if problem.errno not in LOCKLESS or not make:
                os.close(handle)
                raise
            log.warning("%s: this file system knows no locks; let only one process write there", path.parent)
            return handle
        if mine and _is(handle, path):
            return handle
        os.close(handle)
        if not mine:
            return None
        # Its owner has removed it between our opening and our locking it: that was another file.


def release(handle: int, path: Path) -> None:
    """Release what `acquire` returned; the file goes, too."""
    if os.name == "nt":  # where an open file cannot be removed
        os.close(handle)
        with suppress(PermissionError):  # the next one has it open already
            path.unlink(missing_ok=True)
        return
    path.unlink(missing_ok=True)
    os.close(handle)


def _is(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


@contextmanager
def _about(folder: Path) -> Iterator[None]:
    """Errors about the lock are errors about the folder: nothing can be written there."""
    try:
        yield
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, str(folder)) from problem


def _owner(path: Path) -> str:
    try:
        number = path.read_text(encoding="ascii")
    except (OSError, ValueError):
        number = ""
    return f"another process ({number})" if number.isdigit() else "another process"


if os.name == "nt":
    import msvcrt

    def _lock(handle: int) -> bool:
        """Whether nobody else has it."""
        os.lseek(handle, PLACE, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # pyright: ignore[reportAttributeAccessIssue]
        except OSError as problem:
            if problem.errno in (errno.EACCES, errno.EDEADLK):
                return False
            raise
        os.lseek(handle, 0, os.SEEK_SET)
        return True

else:
    import fcntl

    def _lock(handle: int) -> bool:
        """Whether nobody else has it."""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
