# SPDX-License-Identifier: MIT
"""Reads the animation.glb that deepfracture writes: bodies, their surfaces, and where they are when."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

DTYPES = {5126: np.float32, 5125: np.uint32, 5123: np.uint16}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class Part:
    """Triangles of one material; a vertex for each normal and texture coordinate that meet at a point."""

    material: str
    vertices: np.ndarray
    """About the body's pivot, in the user's units, shape (n, 3)."""
    normals: np.ndarray
    uv: np.ndarray | None
    """v upward, shape (n, 2)."""
    faces: np.ndarray


@dataclass(frozen=True)
class Body:
    """One body and its motion in the user's coordinates."""

    name: str
    kind: str
    mass: float | None
    """[kg], of a body two metres long."""
    rest: np.ndarray | None
    """Where its pivot is in the unbroken object, shape (3,)."""
    parts: tuple[Part, ...]
    start: float
    """When it comes [s]; `stop`: when it goes."""
    stop: float
    moves: tuple[np.ndarray, np.ndarray]
    """Times [s] and places (k, 3) of its pivot."""
    turns: tuple[np.ndarray, np.ndarray]
    """Times [s] and rotations (k, 4), w first, neighbours in one half sphere."""

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (n, 3) and rotations (n, 4)."""
        places = np.stack([np.interp(times, self.moves[0], column) for column in self.moves[1].T], axis=1)
        turns = np.stack([np.interp(times, self.turns[0], column) for column in self.turns[1].T], axis=1)
        return places, turns / np.linalg.norm(turns, axis=1, keepdims=True)


@dataclass(frozen=True)
class Animation:
    """Everything in the file."""

    bodies: tuple[Body, ...]
    step: float
    """Between frames [s]."""
    duration: float
    """[s]"""


def read(path: Path) -> Animation:
    """The bodies of a file that deepfracture wrote."""
    file = _File(path)
    extras = file.doc["asset"]["extras"]
    step = 1 / extras["frame_rate"]
    duration = (extras["frames"] - 1) * step
    nodes = file.doc["nodes"]
    user = next(node for node in nodes if node.get("name") == "user_from_world")
    bodies = tuple(file.body(index, user, duration) for index in user["children"])
    return Animation(bodies, step, duration)


class _File:
    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        length = struct.unpack("<I", data[12:16])[0]
        self.doc = json.loads(data[20 : 20 + length])
        self.blob = data[28 + length :]
        self.channels = {}
        for animation in self.doc.get("animations", []):
            for channel in animation["channels"]:
                target = channel["target"]
                self.channels[target["node"], target["path"]] = animation["samplers"][channel["sampler"]]

    def values(self, index: int) -> np.ndarray:
        accessor = self.doc["accessors"][index]
        view = self.doc["bufferViews"][accessor["bufferView"]]
        width = WIDTHS[accessor["type"]]
        flat = np.frombuffer(
            self.blob, DTYPES[accessor["componentType"]], accessor["count"] * width, view.get("byteOffset", 0)
        )
        return flat.reshape(accessor["count"], width)

    def keys(self, node: int, path: str, otherwise: list[float]) -> tuple[np.ndarray, np.ndarray]:
        sampler = self.channels.get((node, path))
        if sampler is None:
            fixed = self.doc["nodes"][node].get(path, otherwise)
            return np.zeros(1), np.array([fixed], float)
        return self.values(sampler["input"])[:, 0].astype(float), self.values(sampler["output"]).astype(float)

    def body(self, index: int, user: dict, duration: float) -> Body:
        node = self.doc["nodes"][index]
        scale = user.get("scale", [1.0])[0]
        turn = np.roll(user.get("rotation", [0, 0, 0, 1]), 1)
        shift = np.array(user.get("translation", [0, 0, 0]), float)
        when, places = self.keys(index, "translation", [0, 0, 0])
        since, turns = self.keys(index, "rotation", [0, 0, 0, 1])
        steps, sizes = self.keys(index, "scale", [1, 1, 1])
        there = np.flatnonzero(sizes[:, 0] > 0)
        stop = steps[there[-1] + 1] if there[-1] + 1 < len(steps) else np.inf
        extras = node.get("extras", {})
        return Body(
            node["name"],
            extras.get("kind", "fragment"),
            extras.get("mass"),
            np.array(extras["rest"]) if "rest" in extras else None,
            tuple(self.part(primitive, scale) for primitive in self.doc["meshes"][node["mesh"]]["primitives"]),
            float(steps[there[0]]),
            float(stop),
            (when, scale * _turned(turn, places) + shift),
            (since, _after(turn, np.roll(turns, 1, axis=1))),
        )

    def part(self, primitive: dict, scale: float) -> Part:
        attributes = primitive["attributes"]
        uv = None
        if "TEXCOORD_0" in attributes:
            uv = self.values(attributes["TEXCOORD_0"]) * [1, -1] + [0, 1]
        return Part(
            self.doc["materials"][primitive["material"]]["name"],
            scale * self.values(attributes["POSITION"]).astype(float),
            self.values(attributes["NORMAL"]),
            uv,
            self.values(primitive["indices"]).reshape(-1, 3).astype(np.int64),
        )


def _turned(quat: np.ndarray, points: np.ndarray) -> np.ndarray:
    w, axis = quat[0], quat[1:]
    return points + 2 * np.cross(axis, np.cross(axis, points) + w * points)


def _after(first: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """The products first * quats, w first."""
    w, v = quats[:, :1], quats[:, 1:]
    real = first[0] * w - (v @ first[1:])[:, None]
    return np.concatenate([real, first[0] * v + w * first[1:] + np.cross(first[1:], v)], axis=1)
