"""Where the objects of a data set lie: in a folder, or in a bucket that speaks S3.

An object appears whole or not at all, and `create` lets exactly one of several writers win: a data set needs no more
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

ABREAST = 32
"""Objects that are asked of a bucket at once: each answer takes tens of milliseconds."""
PATIENCE = timedelta(seconds=60)
"""How long a bucket that does not answer is asked again."""


class NotReached(BadInput):
    """The storage does not do what it should: a full disk, a missing right, a network that is down."""

    status = 1


class Storage(Protocol):
    """Objects by their keys, which are relative paths with slashes."""

    @property
    def place(self) -> str:
        """As a person writes it."""
        ...

    def read(self, key: str, limit: int) -> bytes | None:
        """The object, None if there is none.

        Raises:
            BadInput: It is larger than `limit` bytes, or lies outside the data set.
            NotReached: It cannot be read."""
        ...

    def read_all(self, keys: Sequence[str], limit: int) -> Iterator[bytes | BadInput | None]:
        """Many objects in the order of their keys, each as by `read`, or why it is not trusted."""
        ...

    def write(self, key: str, data: bytes) -> None:
        """Put an object there, in the place of a former one."""
        ...

    def create(self, key: str, data: bytes) -> bool:
        """Put an object there unless there is one; whether this call did."""
        ...

    def names(self, folder: str) -> list[str]:
        """What lies directly in a folder ("" for all of it), hidden names left out, sorted."""
        ...

    def erase(self, key: str) -> None:
        """Remove an object; there may be none."""
        ...

    def remove_stale(self) -> None:
        """Drop what writers that are no more left half written."""
        ...


def storage_at(place: str | Path | Storage) -> Storage:
    """The storage that a person means by a folder or by `s3://bucket/prefix`.

    Raises:
        BadInput: It is the address of something else, or what reads buckets is not installed."""
    if not isinstance(place, str | Path):
        return place
    text = place.as_posix() if isinstance(place, Path) else place
    # A Path makes one slash of two.
    found = re.match(r"([a-z][a-z0-9+.-]+):/+(.*)", text)
    if found is None:
        return Folder(Path(place))
    scheme, rest = found.groups()
    bucket, _, prefix = rest.strip("/").partition("/")
    if scheme != "s3" or not bucket or not prefix:
        raise BadInput(f"{text}: a data set lies in a folder or at s3://BUCKET/PREFIX")
    require("obstore", extra="s3", to="keep data sets in buckets")
    return Bucket(bucket, prefix)


@dataclass(frozen=True)
class Folder:
    """A local or shared folder."""

    root: Path

    @property
    def place(self) -> str:
        return str(self.root)

    def read(self, key: str, limit: int) -> bytes | None:
        path = self._inside(key)
        with _told(path, "read"):
            try:
                about = path.stat()
            except (FileNotFoundError, NotADirectoryError):
                return None
            if not stat.S_ISREG(about.st_mode):
                raise BadInput(f"{path}: not a file; a data set holds files only")
            if about.st_size > limit:
                raise BadInput(f"{path}: {about.st_size} bytes, more than the {limit} that it may have; not trusted")
            with path.open("rb") as file:
                return file.read(about.st_size)

    def read_all(self, keys: Sequence[str], limit: int) -> Iterator[bytes | BadInput | None]:
        return (_tried(self, key, limit) for key in keys)

    def write(self, key: str, data: bytes) -> None:
        path = self._inside(key)
        with self._written(path, data) as temporary:
            os.replace(temporary, path)

    def create(self, key: str, data: bytes) -> bool:
        path = self._inside(key)
        if path.exists():
            return False
        with self._written(path, data) as temporary:
            try:
                os.link(temporary, path)
            except FileExistsError:
                return False
        return True

    def names(self, folder: str) -> list[str]:
        path = self._inside(folder)
        with _told(path, "read"):
            if not path.exists():
                return []
            if not path.is_dir():
                raise BadInput(f"{path}: not a folder, so there is no data set; use another name")
            return sorted(entry.name for entry in os.scandir(path) if not entry.name.startswith("."))

    def erase(self, key: str) -> None:
        path = self._inside(key)
        with _told(path, "removed"):
            path.unlink(missing_ok=True)

    def remove_stale(self) -> None:
        if self.root.is_dir():
            remove_stale(self.root)

    def _inside(self, key: str) -> Path:
        """The path of a key; a link that leads out of the folder is not followed."""
        path = self.root / key
        root = os.path.realpath(self.root)
        real = os.path.realpath(path)
        if real != root and not real.startswith(root.rstrip(os.sep) + os.sep):
            raise BadInput(f"{path}: leads out of the data set, to {real}; not trusted")
        return path

    @contextmanager
    def _written(self, path: Path, data: bytes) -> Iterator[Path]:
        """A hidden file with `data`, to be moved to `path` or linked there; gone when the block ends."""
        with _told(path, "written"):
            path.parent.mkdir(parents=True, exist_ok=True)
            with scratch_folder(self.root) as folder, (folder / "object").open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())  # a record must not be on the disk before what it tells of
                yield folder / "object"


@dataclass(frozen=True)
class Bucket:
    """A part of a bucket, by the S3 protocol. Keys, region and endpoint are what AWS_* in the environment say."""

    bucket: str
    prefix: str

    @property
    def place(self) -> str:
        return f"s3://{self.bucket}/{self.prefix}"

    @cached_property
    def _store(self) -> Any:
        from obstore.store import S3Store

        endpoint = os.environ.get("AWS_ENDPOINT_URL", os.environ.get("AWS_ENDPOINT", ""))
        # Who names a plain http:// endpoint means it.
        with self._told("opened"):
            return S3Store(
                self.bucket,
                prefix=self.prefix,
                client_options={"allow_http": endpoint.startswith("http://")},
                retry_config={"retry_timeout": PATIENCE},
            )

    def read(self, key: str, limit: int) -> bytes | None:
        import obstore

        with self._told(f"read at {key}"):
            try:
                found = obstore.get(self._store, key)
            except FileNotFoundError:
                return None
            size = found.meta["size"]
            if size > limit:
                raise BadInput(f"{self.place}/{key}: {size} bytes, more than the {limit} that it may have; not trusted")
            return bytes(found.bytes())

    def read_all(self, keys: Sequence[str], limit: int) -> Iterator[bytes | BadInput | None]:
        with ThreadPoolExecutor(ABREAST) as threads:
            for start in range(0, len(keys), 8 * ABREAST):  # what has been read and not been used stays bounded
                yield from threads.map(lambda key: _tried(self, key, limit), keys[start : start + 8 * ABREAST])

    def write(self, key: str, data: bytes) -> None:
        import obstore

        with self._told(f"written at {key}"):
            obstore.put(self._store, key, data)

    def create(self, key: str, data: bytes) -> bool:
        import obstore
        from obstore.exceptions import AlreadyExistsError

        with self._told(f"written at {key}"):
            try:
                obstore.put(self._store, key, data, mode="create")
            except AlreadyExistsError:
                return False
        return True

    def names(self, folder: str) -> list[str]:
        import obstore

        with self._told("listed"):
            found = obstore.list_with_delimiter(self._store, folder or None)
        paths = [*found["common_prefixes"], *(item["path"] for item in found["objects"])]
        return sorted(name for name in (path.rstrip("/").rpartition("/")[2] for path in paths) if name[0] != ".")

    def erase(self, key: str) -> None:
        import obstore

        with self._told(f"removed at {key}"), suppress(FileNotFoundError):
            obstore.delete(self._store, key)

    def remove_stale(self) -> None:
        """Nothing to do: an object that was not sent to its end is none."""

    @contextmanager
    def _told(self, done: str) -> Iterator[None]:
        """What goes wrong on the way to the bucket, in one line."""
        from obstore.exceptions import BaseError

        try:
            yield
        except (BaseError, OSError) as error:
            text = " ".join(str(error).split())
            said = re.search(r"<Message>(.*?)</Message>", text)
            reason = said[1] if said else text.partition(" Debug source")[0][:200]
            raise NotReached(
                f"{self.place}: cannot be {done} ({reason}); the environment says where and who: AWS_ENDPOINT_URL, "
                "AWS_REGION, AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY"
            ) from error


def _tried(storage: Storage, key: str, limit: int) -> bytes | BadInput | None:
    try:
        return storage.read(key, limit)
    except NotReached:
        raise
    except BadInput as problem:
        return problem


@contextmanager
def _told(path: Path, done: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        named = error if error.filename else OSError(error.errno, error.strerror, str(path))
        raise NotReached(
            explain_write_error(named) or f"{path}: cannot be {done}: {error.strerror or error}"
        ) from error
