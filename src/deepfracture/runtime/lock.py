"""Exclusive file locks that the operating system releases with the process that holds them.

The filelock library does not replace them: its lock file stays behind, does not name the holder, and cannot be
acquired without creating it, which the removal of stale scratch folders needs."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from deepfracture.runtime.progress import log
from deepfracture.types import BadInput

LOCK_FILE = ".deepfracture.lock"
UNSUPPORTED = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""Errors of file systems without locks."""
LOCKED_BYTE = 1 << 30
"""Byte that is locked on Windows, where a locked byte cannot be read: far beyond the content of the file."""


@contextmanager
def exclusive(folder: str | os.PathLike) -> Iterator[None]:
    """Hold the lock of `folder` in this block. The folder is created where missing, and removed again if left empty.

    Raises:
        BadInput: Another process holds it; the message names the process.
    """
    folder = Path(folder)
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    path = folder / LOCK_FILE
    with _errors_name(folder):
        while True:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                handle = acquire(path)
                break
            except (FileExistsError, FileNotFoundError):  # another process removes it at the same time
                if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
                    raise
    if handle is None:
        raise BadInput(f"{folder}: {_holder(path)} is writing to it; wait until it ends, or use another folder")
    try:
        with _errors_name(folder):
            os.write(handle, str(os.getpid()).encode())
        yield
    finally:
        release(handle, path)
        with suppress(OSError):  # not empty
            for place in missing:
                place.rmdir()


def acquire(path: Path, *, create: bool = True) -> int | None:
    """Lock the file `path`; the descriptor to pass to `release`, or None if the lock is held, by any process or thread.

    create: create the file where missing; otherwise FileNotFoundError. On file systems without locks, `create`
    succeeds with a warning; otherwise OSError."""
    flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | (os.O_CREAT if create else 0)
    while True:
        handle = os.open(path, flags, 0o666)
        try:
            locked = _lock(handle)
        except OSError as problem:
            if problem.errno not in UNSUPPORTED or not create:
                os.close(handle)
                raise
            log.warning("%s: this file system has no locks; let only one process write there", path.parent)
            return handle
        if locked and _same_file(handle, path):
            return handle
        os.close(handle)
        if not locked:
            return None
        # The holder removed the file between opening and locking: try the new one.


def release(handle: int, path: Path) -> None:
    """Release the lock that `acquire` returned, and remove its file."""
    if os.name == "nt":  # an open file cannot be removed
        os.close(handle)
        with suppress(PermissionError):  # another process has opened it
            path.unlink(missing_ok=True)
        return
    path.unlink(missing_ok=True)
    os.close(handle)


def _same_file(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


@contextmanager
def _errors_name(folder: Path) -> Iterator[None]:
    """Report errors about the lock as errors about the folder: nothing can be written there."""
    try:
        yield
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, str(folder)) from problem


def _holder(path: Path) -> str:
    try:
        number = path.read_text(encoding="ascii")
    except (OSError, ValueError):
        number = ""
    return f"another process ({number})" if number.isdigit() else "another process"


if os.name == "nt":
    import msvcrt

    def _lock(handle: int) -> bool:
        """Lock without waiting; whether that succeeded."""
        os.lseek(handle, LOCKED_BYTE, os.SEEK_SET)
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
        """Lock without waiting; whether that succeeded."""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
