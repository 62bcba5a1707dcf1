"""Object storage of a data set: a folder, or a prefix of an S3 bucket.

An object appears whole or not at all, and of several writers `create` lets exactly one win: a data set asks no more
of its storage than that.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from deepfracture.runtime.extras import require
from deepfracture.runtime.files import explain_write_error, remove_stale, scratch_folder
from deepfracture.types import BadInput

MAX_REQUESTS = 32
"""Concurrent requests to a bucket, each of which takes tens of milliseconds."""
RETRY_TIMEOUT = timedelta(seconds=60)
"""How long a request to a bucket is retried."""


class StorageError(BadInput):
    """The storage fails: a full disk, a missing permission, a network that is down."""

    status = 1


class Storage(Protocol):
    """Objects by key; keys are relative paths with slashes."""

    @property
    def location(self) -> str:
        """The folder or s3:// address, as a user writes it."""
        ...

    def read(self, key: str, limit: int) -> bytes | None:
        """The object, None if there is none.

        Raises:
            BadInput: It is larger than `limit` bytes, or a link leads out of the data set.
            StorageError: It cannot be read."""
        ...

    def read_all(self, keys: Sequence[str], limit: int) -> Iterator[bytes | BadInput | None]:
        """Many objects in the order of `keys`: each what `read` returns, or the BadInput that it raises."""
        ...

    def write(self, key: str, data: bytes) -> None:
        """Write an object, replacing an existing one."""
        ...

    def create(self, key: str, data: bytes) -> bool:
        """Write an object unless it exists. Returns whether this call wrote it."""
        ...

    def names(self, folder: str) -> list[str]:
        """The sorted names directly in a folder ("" for the root), without hidden ones."""
        ...

    def delete(self, key: str) -> None:
        """Delete an object if it exists."""
        ...

    def remove_stale(self) -> None:
        """Delete the temporary files of writers that were killed."""
        ...


def open_storage(location: str | Path | Storage) -> Storage:
    """The storage at a folder or at `s3://bucket/prefix`.

    Raises:
        BadInput: The address has another scheme, or obstore, which reads buckets, is not installed."""
    if not isinstance(location, str | Path):
        return location
    text = location.as_posix() if isinstance(location, Path) else location
    # A Path collapses two slashes into one.
    address = re.match(r"([a-z][a-z0-9+.-]+):/+(.*)", text)
    if address is None:
        return Folder(Path(location))
    scheme, rest = address.groups()
    bucket, _, prefix = rest.strip("/").partition("/")
    if scheme != "s3" or not bucket or not prefix:
        raise BadInput(f"{text}: a data set is a folder or s3://BUCKET/PREFIX")
    require("obstore", extra="s3", to="keep data sets in buckets")
    return Bucket(bucket, prefix)


@dataclass(frozen=True)
class Folder:
    """A local or shared folder."""

    root: Path

    @property
    def location(self) -> str:
        return str(self.root)

    def read(self, key: str, limit: int) -> bytes | None:
        path = self._resolve(key)
        with _errors_in_one_line(path, "read"):
            try:
                status = path.stat()
            except (FileNotFoundError, NotADirectoryError):
                return None
            if not stat.S_ISREG(status.st_mode):
                raise BadInput(f"{path}: not a file; a data set holds only files")
            if status.st_size > limit:
                raise BadInput(f"{path}: {status.st_size} bytes, more than the {limit} allowed; not trusted")
            with path.open("rb") as file:
                return file.read(status.st_size)

    def read_all(self, keys: Sequence[str], limit: int) -> Iterator[bytes | BadInput | None]:
        return (_read_or_error(self, key, limit) for key in keys)

    def write(self, key: str, data: bytes) -> None:
        path = self._resolve(key)
        with self._temporary(path, data) as temporary:
            os.replace(temporary, path)

    def create(self, key: str, data: bytes) -> bool:
        path = self._resolve(key)
        if path.exists():
            return False
        with self._temporary(path, data) as temporary:
            try:
                os.link(temporary, path)
            except FileExistsError:
                return False
        return True

    def names(self, folder: str) -> list[str]:
        path = self._resolve(folder)
        with _errors_in_one_line(path, "read"):
            if not path.exists():
                return []
            if not path.is_dir():
                raise BadInput(f"{path}: not a folder, so not a data set; use another name")
            return sorted(entry.name for entry in os.scandir(path) if not entry.name.startswith("."))

    def delete(self, key: str) -> None:
        path = self._resolve(key)
        with _errors_in_one_line(path, "removed"):
            path.unlink(missing_ok=True)

    def remove_stale(self) -> None:
        if self.root.is_dir():
            remove_stale(self.root)

    def _resolve(self, key: str) -> Path:
        """The path of a key. Raises BadInput if links lead out of the folder."""
        path = self.root / key
        root = os.path.realpath(self.root)
        real = os.path.realpath(path)
        if real != root and not real.startswith(root.rstrip(os.sep) + os.sep):
            raise BadInput(f"{path}: leads out of the data set, to {real}; not trusted")
        return path

    @contextmanager
    def _temporary(self, path: Path, data: bytes) -> Iterator[Path]:
        """A hidden file with `data`, to be moved or linked to `path`; deleted when the block ends."""
        with _errors_in_one_line(path, "written"):
            path.parent.mkdir(parents=True, exist_ok=True)
            with scratch_folder(self.root) as folder, (folder / "object").open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())  # a record must not reach the disk before the objects it refers to
                yield folder / "object"


@dataclass(frozen=True)
class Bucket:
    """A prefix of an S3 bucket. Credentials, region and endpoint come from AWS_* in the environment."""

    bucket: str
    prefix: str

    @property
    def location(self) -> str:
        return f"s3://{self.bucket}/{self.prefix}"

    @cached_property
    def _store(self) -> Any:
        from obstore.store import S3Store

        endpoint = os.environ.get("AWS_ENDPOINT_URL", os.environ.get("AWS_ENDPOINT", ""))
        # A plain http:// endpoint is used only if the environment names it.
        with self._errors_in_one_line("opened"):
            return S3Store(
                self.bucket,
                prefix=self.prefix,
                client_options={"allow_http": endpoint.startswith("http://")},
                retry_config={"retry_timeout": RETRY_TIMEOUT},
            )

    def read(self, key: str, limit: int) -> bytes | None:
        import obstore

        with self._errors_in_one_line(f"read at {key}"):
            try:
                found = obstore.get(self._store, key)
            except FileNotFoundError:
                return None
            size = found.meta["size"]
            if size > limit:
                raise BadInput(f"{self.location}/{key}: {size} bytes, more than the {limit} allowed; not trusted")
            return bytes(found.bytes())

    def read_all(self, keys: Sequence[str], limit: int) -> Iterator[bytes | BadInput | None]:
        with ThreadPoolExecutor(MAX_REQUESTS) as threads:
            for start in range(0, len(keys), 8 * MAX_REQUESTS):  # bounds what is read ahead
                yield from threads.map(
                    lambda key: _read_or_error(self, key, limit), keys[start : start + 8 * MAX_REQUESTS]
                )

    def write(self, key: str, data: bytes) -> None:
        import obstore

        with self._errors_in_one_line(f"written at {key}"):
            obstore.put(self._store, key, data)

    def create(self, key: str, data: bytes) -> bool:
        import obstore
        from obstore.exceptions import AlreadyExistsError

        with self._errors_in_one_line(f"written at {key}"):
            try:
                obstore.put(self._store, key, data, mode="create")
            except AlreadyExistsError:
                return False
        return True

    def names(self, folder: str) -> list[str]:
        import obstore

        with self._errors_in_one_line("listed"):
            listing = obstore.list_with_delimiter(self._store, folder or None)
        paths = [*listing["common_prefixes"], *(item["path"] for item in listing["objects"])]
        return sorted(name for name in (path.rstrip("/").rpartition("/")[2] for path in paths) if name[0] != ".")

    def delete(self, key: str) -> None:
        import obstore

        with self._errors_in_one_line(f"removed at {key}"), suppress(FileNotFoundError):
            obstore.delete(self._store, key)

    def remove_stale(self) -> None:
        """Nothing to do: an incomplete upload is no object."""

    @contextmanager
    def _errors_in_one_line(self, action: str) -> Iterator[None]:
        """Turn errors of the bucket into a StorageError of one line."""
        from obstore.exceptions import BaseError

        try:
            yield
        except (BaseError, OSError) as error:
            text = " ".join(str(error).split())
            message = re.search(r"<Message>(.*?)</Message>", text)
            reason = message[1] if message else text.partition(" Debug source")[0][:200]
            raise StorageError(
                f"{self.location}: cannot be {action} ({reason}); set endpoint and credentials in the environment: "
                "AWS_ENDPOINT_URL, AWS_REGION, AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY"
            ) from error


def _read_or_error(storage: Storage, key: str, limit: int) -> bytes | BadInput | None:
    try:
        return storage.read(key, limit)
    except StorageError:
        raise
    except BadInput as problem:
        return problem


@contextmanager
def _errors_in_one_line(path: Path, action: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        named = error if error.filename else OSError(error.errno, error.strerror, str(path))
        raise StorageError(
            explain_write_error(named) or f"{path}: cannot be {action}: {error.strerror or error}"
        ) from error
