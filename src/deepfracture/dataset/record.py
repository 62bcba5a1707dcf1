"""What became of one collision: the small file whose appearance makes an entry part of a data set."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

from deepfracture.dataset.arrays import ARRAYS, CAPACITY
from deepfracture.types import Impact

KINDS = ("broken", "unbroken", "failed")
IMPACT_FIELDS = ("position", "direction", "magnitude", "normal")
FOLDER = "entries"
LARGEST = 1 << 20
"""Bytes of a record or manifest that is still read."""
NAME = re.compile(r"(\d{6})\.json")


@dataclass(frozen=True)
class Stored:
    """An object beside the record."""

    size: int
    """[bytes]; 0: all is zero, and there is no object."""
    sha256: str

    @staticmethod
    def of(data: bytes) -> Stored:
        return Stored(len(data), hashlib.sha256(data).hexdigest())


@dataclass(frozen=True, eq=False)
class Record:
    """One collision."""

    number: int
    kind: str
    """broken, unbroken or failed."""
    seed: int
    impact: Impact | None = None
    """Of one that broke the shape."""
    fragments: int = 0
    objects: Mapping[str, Stored] = field(default_factory=dict)
    """Of one that broke the shape: the shards of `ARRAYS`."""
    impulse: float | None = None
    """Of one that broke nothing, the strongest [N s]; None: the ball missed."""
    speed: float | None = None
    """Closing speed there [m/s]."""
    reason: str = ""
    """Why it could not be simulated."""

    @property
    def name(self) -> str:
        return f"{self.number:06d}"

    @property
    def key(self) -> str:
        return record_key(self.number)

    def to_bytes(self) -> bytes:
        """As a file; the same bytes for the same record."""
        said = self._said()
        return json.dumps({**said, "sha256": _seal(said)}).encode()

    def _said(self) -> dict[str, Any]:
        said: dict[str, Any] = {"kind": self.kind, "seed": self.seed}
        if self.kind == "failed":
            return said | {"reason": self.reason}
        if self.impact is None:
            return said | {"impulse": self.impulse, "speed": self.speed}
        hit = self.impact
        impact = {name: getattr(hit, name).tolist() for name in IMPACT_FIELDS}
        objects = {name: {"bytes": stored.size, "sha256": stored.sha256} for name, stored in self.objects.items()}
        return said | {
            "impact": {**impact, "speed": hit.speed, "radius": hit.radius},
            "fragments": self.fragments,
            "objects": objects,
        }


def record_key(number: int) -> str:
    """Where the record of an entry lies."""
    assert 0 <= number < CAPACITY
    return f"{FOLDER}/{number:06d}.json"


def read_record(number: int, data: bytes) -> Record:
    """The record in a file.

    Raises:
        ValueError, KeyError, TypeError: There is none in it, or not as it was written."""
    said = parse(data)
    seal = said.pop("sha256")
    if seal != _seal(said):
        raise ValueError("does not agree with its own sha256")
    kind, seed = said["kind"], int(said["seed"])
    if kind == "failed":
        return Record(number, kind, seed, reason=str(said["reason"]))
    if kind == "unbroken":
        impulse, speed = (None if said[name] is None else float(said[name]) for name in ("impulse", "speed"))
        return Record(number, kind, seed, impulse=impulse, speed=speed)
    if kind != "broken":
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {str(kind)[:40]!r}")
    about = said["impact"]
    arrays = {name: about[name] for name in IMPACT_FIELDS}
    impact = Impact(**arrays, speed=float(about["speed"]), radius=float(about["radius"]))
    objects = {name: said["objects"][name] for name in ARRAYS}
    stored = {name: Stored(int(one["bytes"]), str(one["sha256"])) for name, one in objects.items()}
    return Record(number, kind, seed, impact, int(said["fragments"]), stored)


def parse(data: bytes) -> dict[str, Any]:
    """A JSON object from a stranger.

    Raises:
        ValueError: It is something else."""
    try:
        found = json.loads(data, parse_constant=_refuse)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(found, dict):
        raise ValueError("not a JSON object")
    return found


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number")


def _seal(said: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
