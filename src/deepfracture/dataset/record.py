"""The record of an entry: the small JSON file whose existence makes the entry part of a data set."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

from deepfracture.dataset.arrays import CAPACITY, PATTERN_ARRAYS
from deepfracture.types import Impact

KINDS = ("broken", "unbroken", "failed")
IMPACT_FIELDS = ("position", "direction", "magnitude", "normal")
RECORD_FOLDER = "entries"
RECORD_NAME = re.compile(r"(\d{6})\.json")
MAX_JSON_BYTES = 1 << 20
"""Largest record or manifest that is read [bytes]."""


@dataclass(frozen=True)
class ObjectInfo:
    """Size and hash of an object that a record refers to."""

    size: int
    """[bytes]; 0 for an array of zeros, which has no object."""
    sha256: str

    @staticmethod
    def of(data: bytes) -> ObjectInfo:
        return ObjectInfo(len(data), hashlib.sha256(data).hexdigest())


@dataclass(frozen=True, eq=False)
class Record:
    """The result of one simulated collision."""

    number: int
    kind: str
    """broken, unbroken or failed."""
    seed: int
    impact: Impact | None = None
    """Of a broken one."""
    fragments: int = 0
    objects: Mapping[str, ObjectInfo] = field(default_factory=dict)
    """Of a broken one: the shards of `PATTERN_ARRAYS`."""
    impulse: float | None = None
    """Of an unbroken one: the strongest impulse [N s]; None if the ball missed."""
    speed: float | None = None
    """Of an unbroken one: closing speed of that contact [m/s]."""
    reason: str = ""
    """Of a failed one: why it could not be simulated."""

    @property
    def name(self) -> str:
        return f"{self.number:06d}"

    @property
    def key(self) -> str:
        return record_key(self.number)

    def to_bytes(self) -> bytes:
        """The file; the same bytes for the same record."""
        content = self.to_dict()
        return json.dumps({**content, "sha256": _checksum(content)}).encode()

    def to_dict(self) -> dict[str, Any]:
        """The content of the file, without its checksum."""
        content: dict[str, Any] = {"kind": self.kind, "seed": self.seed}
        if self.kind == "failed":
            return content | {"reason": self.reason}
        if self.impact is None:
            return content | {"impulse": self.impulse, "speed": self.speed}
        impact = {name: getattr(self.impact, name).tolist() for name in IMPACT_FIELDS}
        objects = {name: {"bytes": info.size, "sha256": info.sha256} for name, info in self.objects.items()}
        return content | {
            "impact": {**impact, "speed": self.impact.speed, "radius": self.impact.radius},
            "fragments": self.fragments,
            "objects": objects,
        }


def record_key(number: int) -> str:
    """Key of the record of an entry."""
    assert 0 <= number < CAPACITY
    return f"{RECORD_FOLDER}/{number:06d}.json"


def read_record(number: int, data: bytes) -> Record:
    """The record in a file.

    Raises:
        ValueError, KeyError, TypeError: The file holds none, or not as it was written."""
    content = parse_json(data)
    if content.pop("sha256") != _checksum(content):
        raise ValueError("does not agree with its own sha256")
    kind, seed = content["kind"], int(content["seed"])
    if kind == "failed":
        return Record(number, kind, seed, reason=str(content["reason"]))
    if kind == "unbroken":
        impulse, speed = (None if content[name] is None else float(content[name]) for name in ("impulse", "speed"))
        return Record(number, kind, seed, impulse=impulse, speed=speed)
    if kind != "broken":
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {str(kind)[:40]!r}")
    hit = content["impact"]
    vectors = {name: hit[name] for name in IMPACT_FIELDS}
    impact = Impact(**vectors, speed=float(hit["speed"]), radius=float(hit["radius"]))
    stored = {name: content["objects"][name] for name in PATTERN_ARRAYS}
    objects = {name: ObjectInfo(int(info["bytes"]), str(info["sha256"])) for name, info in stored.items()}
    return Record(number, kind, seed, impact, int(content["fragments"]), objects)


def parse_json(data: bytes) -> dict[str, Any]:
    """A JSON object from an untrusted file.

    Raises:
        ValueError: It is something else."""
    try:
        found = json.loads(data, parse_constant=_reject)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(found, dict):
        raise ValueError("not a JSON object")
    return found


def _reject(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number")


def _checksum(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
