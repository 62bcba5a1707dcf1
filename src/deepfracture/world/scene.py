"""Scenes are data: what stands where, what flies at it, and the world around them. TOML or JSON files."""

from __future__ import annotations

import json
import os
import reprlib
import sys
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Floats, Shape, Touch
from deepfracture.world.engine import ENGINES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports]

Vector = tuple[float, float, float]
STEEL = 7800.0
"""Density of the balls that the builders throw [kg/m^3]."""
GRAVITY = 9.81
LARGEST = 64 << 20
"""Bytes of a scene file."""
MOST_FRAMES, MOST_STEPS = 100_000, 10_000_000
"""Of a whole scene: half an hour at 60 frames a second, eleven hours at 240 steps."""
UPRIGHT = {"z": (1.0, 0.0, 0.0, 0.0), "y": (0.5**0.5, 0.5**0.5, 0.0, 0.0), "x": (0.5**0.5, 0.0, -(0.5**0.5), 0.0)}
"""Rotation (w, x, y, z) that turns this axis of the file to the world's z."""


@dataclass(frozen=True)
class Placed:
    """A breakable shape at the start."""

    shape: str
    """Built-in name, or a mesh file (relative to the scene's file)."""
    material: str
    position: Vector = (0.0, 0.0, 0.0)
    """Of the centre of the shape's box [m]."""
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Rotation world_from_body."""
    velocity: Vector = (0.0, 0.0, 0.0)
    """Of the centre of mass [m/s]."""
    spin: Vector = (0.0, 0.0, 0.0)
    """Angular velocity [rad/s]."""
    repair: bool = False
    """Mend the mesh in the file where it is not closed."""

    def __post_init__(self) -> None:
        _text(self, "shape", "material")
        if not isinstance(self.repair, bool):
            raise BadInput(f"repair must be true or false, got {_shown(self.repair)}")
        _vectors(self, position=3, quat_wxyz=4, velocity=3, spin=3)
        _unit(self)


@dataclass(frozen=True)
class Ball:
    """An unbreakable ball."""

    radius: float
    """[m]"""
    density: float
    """[kg/m^3]"""
    position: Vector
    """[m]"""
    velocity: Vector
    """[m/s]"""
    delay: float = 0.0
    """When it appears [s]."""

    def __post_init__(self) -> None:
        _positive(self, "radius", "density")
        _at_least_zero(self, "delay")
        _vectors(self, position=3, velocity=3)

    @property
    def mass(self) -> float:
        """[kg]"""
        return self.density * 4 / 3 * np.pi * self.radius**3


@dataclass(frozen=True)
class Floor:
    """A horizontal floor."""

    height: float = 0.0
    """[m]"""
    friction: float = 0.6
    """Coulomb coefficient against everything."""

    def __post_init__(self) -> None:
        _number(self, "height")
        _at_least_zero(self, "friction")


@dataclass(frozen=True)
class Block:
    """A fixed box: an edge to break something over, a support, a wall."""

    position: Vector
    """Of its centre [m]."""
    half_sides: Vector
    """Half the length of its sides [m]."""
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Rotation world_from_block."""
    friction: float = 0.6
    """Coulomb coefficient against everything."""

    def __post_init__(self) -> None:
        _vectors(self, position=3, half_sides=3, quat_wxyz=4)
        _at_least_zero(self, "friction")
        if not min(self.half_sides) > 0:
            raise BadInput(f"half_sides must be positive, got {list(self.half_sides)}")
        _unit(self)


@dataclass(frozen=True)
class Scene:
    """Everything that a simulation needs to know besides how things break."""

    shapes: tuple[Placed, ...]
    balls: tuple[Ball, ...] = ()
    floor: Floor | None = None
    gravity: float = GRAVITY
    """Along -z [m/s^2]."""
    duration: float = 5.0
    """Longest time simulated [s]; it ends sooner once everything lies still."""
    frame_rate: int = 60
    """Frames a second in the recording."""
    steps_per_second: int = 240
    """Of the engine; a multiple of the frame rate."""
    friction: float = 0.5
    """Coulomb coefficient between bodies."""
    restitution: float = 0.2
    """Of every contact."""
    push: float = 0.3
    """Share of a breaking collision's impulse that the shape takes as a whole before it is fragments: 1 the
    fragments start from the velocity after the collision, 0 from the velocity before it, and what struck
    keeps going and pushes the fragments that it meets. Momentum is conserved for every share."""
    engine: str = "rapier"
    seed: int = 0
    breaker: str = ""
    """Which breaker to use; empty: whatever the caller has."""
    blocks: tuple[Block, ...] = ()
    refracture: int = 0
    """Generations of fragments that may break again (see `world.pieces`) ..."""
    again: str = "anything"
    """... and what breaks them: "anything" that they meet, or only "balls" that came after them (see
    `stage.STRIKING`), which is much less work."""

    def __post_init__(self) -> None:
        if not self.shapes:
            raise BadInput("shapes must name at least one shape")
        _positive(self, "duration", "friction")
        _at_least_zero(self, "gravity", "restitution", "push")
        _whole(self, "frame_rate", "steps_per_second", "seed", "refracture")
        if self.restitution > 1 or self.push > 1:
            raise BadInput(f"restitution and push must be at most 1, got {self.restitution} and {self.push}")
        if self.frame_rate < 1 or self.steps_per_second < 1 or self.steps_per_second % self.frame_rate:
            raise BadInput(
                f"steps_per_second must be a multiple of frame_rate, got {self.steps_per_second} and {self.frame_rate}"
            )
        if self.frame_rate > MOST_FRAMES / self.duration or self.steps_per_second > MOST_STEPS / self.duration:
            raise BadInput(
                f"duration must be shorter: {self.duration:g} s have more than {MOST_FRAMES} frames "
                f"or {MOST_STEPS} steps"
            )
        if not isinstance(self.engine, str) or self.engine not in ENGINES:
            near = did_you_mean(str(self.engine), ENGINES)
            raise BadInput(f"engine must be one of {', '.join(ENGINES)}, got {_shown(self.engine)}{near}")
        if self.again not in ("anything", "balls"):
            raise BadInput(f"again must be anything or balls, got {_shown(self.again)}")
        if not isinstance(self.breaker, str):
            raise BadInput(f"breaker must be text, got {_shown(self.breaker)}")

    @property
    def touch(self) -> Touch:
        """How its bodies touch, for other programs."""
        fixed = {f"block{i}": block.friction for i, block in enumerate(self.blocks)}
        if self.floor is not None:
            fixed["floor"] = self.floor.friction
        return Touch(self.friction, fixed, self.restitution)


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene in a .toml or .json file. BadInput names the file and the field."""
    path = Path(path)
    if path.suffix not in (".toml", ".json"):
        raise BadInput(f"{path}: a scene is a .toml or .json file")
    try:
        data = _parsed(path)
        scene = _scene(data)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return replace(scene, shapes=tuple(_beside(path, placed) for placed in scene.shapes))


def _parsed(path: Path) -> Any:
    """What the file says, or BadInput that has yet to name it."""
    try:
        if path.exists() and not path.is_file():  # a device may have no end
            raise BadInput("is not a file")
        if path.stat().st_size > LARGEST:
            raise BadInput(f"larger than {LARGEST >> 20} MB, too large for a scene")
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except BadInput:
        raise
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise BadInput("cannot be read: not UTF-8 text") from error
    except RecursionError as error:
        raise BadInput(f"not {path.suffix[1:].upper()} of a scene: nested too deeply") from error
    except ValueError as error:  # of the parsers, or a number of thousands of digits
        raise BadInput(f"not {path.suffix[1:].upper()}: {str(error).splitlines()[0][:200]}") from error


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a .toml or .json file that `load_scene` reads back as the same scene."""
    path = Path(path)
    if path.suffix not in (".toml", ".json"):
        raise BadInput(f"{path}: a scene is a .toml or .json file")
    data = {key: value for key, value in asdict(scene).items() if value is not None}
    text = _toml(data) if path.suffix == ".toml" else json.dumps(data, indent=2) + "\n"
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def standing(
    name: str,
    shape: Shape,
    *,
    material: str,
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    repair: bool = False,
) -> Placed:
    """The shape, turned so, a millimetre above a floor at z = 0."""
    lowest = (shape.mesh.vertices @ rotation_matrix(np.asarray(quat_wxyz, float)).T)[:, 2].min()
    return Placed(name, material, (0.0, 0.0, float(-lowest) + 1e-3), quat_wxyz, repair=repair)


def throw_scene(
    name: str,
    shape: Shape,
    rng: np.random.Generator,
    *,
    material: str,
    aim: Floats | None = None,
    direction: Floats | None = None,
    speed: float | None = None,
    radius: float = 0.2,
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    engine: str = "rapier",
    seed: int = 0,
) -> Scene:
    """The shape stands on the floor; a steel ball flies at it.

    `aim` is a point of the body frame that the ball's path goes through, `direction` the way it is thrown
    (world frame); what is not given is drawn: a point near the middle, from anywhere around and slightly
    downwards, at 15 to 25 m/s.
    """
    stands = standing(name, shape, material=material, quat_wxyz=quat_wxyz)
    turn, place = rotation_matrix(np.asarray(quat_wxyz, float)), np.array(stands.position)
    if aim is None:
        aim = rng.uniform(-0.15, 0.15, 3) * np.ptp(shape.mesh.bounds, axis=0)
    if direction is None:
        azimuth = rng.uniform(0, 2 * np.pi)
        direction = np.array([np.cos(azimuth), np.sin(azimuth), -0.15])
    if speed is None:
        speed = float(rng.uniform(15, 25))
    velocity = np.asarray(direction, float) / np.linalg.norm(direction) * speed
    goal = place + turn @ np.asarray(aim, float)
    flight = 4.0 / speed
    start = goal - velocity * flight + [0, 0, GRAVITY * flight**2 / 2]
    start[2] = max(start[2], radius + 0.01)
    ball = Ball(radius, STEEL, _tuple(start), _tuple(velocity))
    return Scene((stands,), (ball,), Floor(), duration=10.0, engine=engine, seed=seed)


def _tuple(vector: Floats) -> Vector:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def _beside(path: Path, placed: Placed) -> Placed:
    """File names of shapes are relative to the scene's own folder."""
    file = path.parent / placed.shape
    return replace(placed, shape=str(file)) if os.path.isfile(file) else placed  # also where no file can be called so


# Reading: dictionaries into dataclasses, with the name of the field in every message.


def _scene(data: Any) -> Scene:
    known = _known(Scene, data, "the file")
    for key, cls in (("shapes", Placed), ("balls", Ball), ("blocks", Block)):
        if key in known:
            if not isinstance(known[key], list):
                raise BadInput(f"{key} must be a list of tables, got {_shown(known[key])}")
            known[key] = tuple(_make(cls, entry, f"{key}[{i}]") for i, entry in enumerate(known[key]))
    if "floor" in known:
        known["floor"] = _make(Floor, known["floor"], "floor")
    return Scene(**known)


def _make(cls: type, data: Any, where: str) -> Any:
    known = _known(cls, data, where)
    try:
        return cls(**{key: tuple(v) if isinstance(v, list) else v for key, v in known.items()})
    except BadInput as error:
        raise BadInput(f"{where}.{error}") from error


def _known(cls: type, data: Any, where: str) -> dict[str, Any]:
    if not isinstance(data, Mapping):
        raise BadInput(f"{where} must be a table, got {_shown(data)}")
    names = [f.name for f in fields(cls)]
    for key in data:
        if key not in names:
            raise BadInput(
                f"{where} has an unknown field {_shown(key)}; it may have {', '.join(names)}{did_you_mean(key, names)}"
            )
    blank = cls.__dataclass_fields__
    for name in names:
        if name not in data and _required(blank[name]):
            raise BadInput(f"{where} lacks the field {name!r}")
    return dict(data)


def _required(field: Any) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _finite(value: Any) -> bool:
    """Whether it is a number that a float can hold."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _shown(value: Any) -> str:
    """A value in a message, abbreviated where it is long."""
    return _short.repr(value)


class _Short(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        """Python refuses to spell out integers of thousands of digits."""
        return repr(x) if x.bit_length() < 200 else f"an integer of {x.bit_length()} bits"


_short = _Short()
_short.maxstring = _short.maxother = 60


def _number(record: Any, *names: str) -> None:
    for name in names:
        value = getattr(record, name)
        if not _finite(value):
            raise BadInput(f"{name} must be a finite number, got {_shown(value)}")


def _positive(record: Any, *names: str) -> None:
    _number(record, *names)
    for name in names:
        if not getattr(record, name) > 0:
            raise BadInput(f"{name} must be positive, got {getattr(record, name)}")


def _at_least_zero(record: Any, *names: str) -> None:
    _number(record, *names)
    for name in names:
        if not getattr(record, name) >= 0:
            raise BadInput(f"{name} must be zero or more, got {getattr(record, name)}")


def _whole(record: Any, *names: str) -> None:
    for name in names:
        value = getattr(record, name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 64:
            raise BadInput(f"{name} must be a whole number, zero or more and less than 2^64, got {_shown(value)}")


def _unit(record: Any) -> None:
    if abs(np.linalg.norm(record.quat_wxyz) - 1) > 1e-3:
        raise BadInput(f"quat_wxyz must have length 1, got {list(record.quat_wxyz)}")


def _text(record: Any, *names: str) -> None:
    for name in names:
        if not isinstance(getattr(record, name), str) or not getattr(record, name):
            raise BadInput(f"{name} must be text, got {_shown(getattr(record, name))}")


def _vectors(record: Any, **lengths: int) -> None:
    for name, length in lengths.items():
        value = getattr(record, name)
        good = isinstance(value, tuple | list) and len(value) == length
        if not good or not all(_finite(v) for v in value):
            raise BadInput(f"{name} must be {length} finite numbers, got {_shown(value)}")
        object.__setattr__(record, name, tuple(float(v) for v in value))


# Writing: TOML has no writer in the standard library, and this is all that a scene needs of it.


TABLES = ("shapes", "balls", "blocks")
"""Fields of a scene that are lists of tables."""


def _toml(data: dict[str, Any]) -> str:
    plain = {k: v for k, v in data.items() if not isinstance(v, dict) and k not in TABLES}
    lines = [f"{key} = {_literal(value)}" for key, value in plain.items()]
    if "floor" in data:
        lines += ["", "[floor]", *(f"{k} = {_literal(v)}" for k, v in data["floor"].items())]
    for table in TABLES:
        for entry in data[table]:
            lines += ["", f"[[{table}]]", *(f"{k} = {_literal(v)}" for k, v in entry.items())]
    return "\n".join(lines) + "\n"


def _literal(value: Any) -> str:
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_literal(v) for v in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
