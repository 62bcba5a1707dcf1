"""How options are shown in the help: types as words, allowed values, no default where the text says what happens."""

from __future__ import annotations

from dataclasses import dataclass, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import tyro
from tyro.conf import Positional

from deepfracture.breakers.options import BreakerOptions
from deepfracture.dataset.options import SimulateOptions
from deepfracture.learn.options import PRESETS, TrainOptions
from deepfracture.types import RESOLUTIONS

# Names that heavy rooms define; a test compares them with the rooms.
MATERIALS = ("glass", "ceramic", "porcelain", "stone", "plaster", "concrete")
ENGINES = ("rapier", "bullet")
SCENES = ("single", "dual", "strength", "points", "shear")
EXECUTORS = ("local", "ray")
DEVICES = ("auto", "cpu", "cuda", "mps")
BENCHMARKS = ("fracture", "carve", "learn", "world", "all")
AXES = ("x", "y", "z")
FORMATS = (
    "glb", "page", "picture", "film", "fragments", "exploded", "usd", "usda", "usdz", "obj-sequence", "ply-sequence",
)  # fmt: skip


def one_of(*values: object) -> str:
    """The allowed values, as the help shows them."""
    return "{" + ",".join(map(str, values)) + "}"


METAVARS = {
    "collisions": "N", "dataset": "FOLDER", "device": one_of(*DEVICES), "epochs": "N", "executor": one_of(*EXECUTORS),
    "address": "ADDRESS", "features": one_of(1, 2), "frames": "N", "heading": "DEGREES", "limit": "SECONDS",
    "max_faces": "N", "memory": "GIGABYTES", "minutes": "MINUTES", "model": "FILE", "preset": one_of(*PRESETS),
    "radius": "METRES", "refracture": "N", "repeats": "N", "resolution": one_of(*RESOLUTIONS), "roughness": "METRES",
    "scene": one_of(*SCENES), "seed": "N", "up": one_of(*AXES), "width": "FACTOR", "workers": "N",
}  # fmt: skip
"""What stands for the value of a field of any options."""


def option(metavar: str) -> Any:
    """An option whose value is shown as `metavar`, and whose default only if there is one."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=_default)


def _default(label: str) -> str:
    return "" if label in ("", "None") else f"(default: {label})"


def _shown(options: type) -> Any:
    """The fields of a dataclass as options of a command, next to each other and without a prefix."""
    hints = get_type_hints(options)
    for name in METAVARS.keys() & hints.keys():
        hints[name] = Annotated[hints[name], option(METAVARS[name])]
    annotated = [(field.name, hints[field.name], field.default) for field in fields(options)]
    return tyro.conf.arg(constructor=make_dataclass(options.__name__, annotated, bases=(options,), frozen=True))


@dataclass(frozen=True)
class ThrowOptions:
    """How the ball is thrown."""

    speed: float = 9.0
    """Speed at which the ball is launched, 4 m away [m/s]; a slow one falls on its way (the shape is 2 m long)."""
    radius: float = 0.2
    """Radius of the steel ball [m]."""
    heading: float | None = None
    """Direction that the ball comes from, degrees around the vertical (default: drawn from the seed)."""
    up: str = "z"
    """Axis of the file that points up."""


ShapeName = Annotated[Positional[str], tyro.conf.arg(metavar="SHAPE")]
File = Annotated[Path | None, option("FILE")]
Folder = Annotated[Path | None, option("FOLDER")]
Count = Annotated[int | None, option("N")]
Engine = Annotated[str, option(one_of(*ENGINES))]
MaterialName = Annotated[str, option(one_of(*MATERIALS))]
Throw = Annotated[tyro.conf.OmitArgPrefixes[ThrowOptions], _shown(ThrowOptions)]
Breaking = Annotated[tyro.conf.OmitArgPrefixes[BreakerOptions], _shown(BreakerOptions)]
Simulating = Annotated[tyro.conf.OmitArgPrefixes[SimulateOptions], _shown(SimulateOptions)]
Training = Annotated[tyro.conf.OmitArgPrefixes[TrainOptions], _shown(TrainOptions)]
