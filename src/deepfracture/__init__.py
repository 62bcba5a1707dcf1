"""deepfracture: brittle fracture, simulated and learned, inside a rigid-body simulation.

What `deepfracture.api` and `deepfracture.types` define is found here too, loaded when it is first asked for:

    import deepfracture as df

    pot = df.load("pot")
    outcome = df.throw(pot, df.breaker("learned", pot), speed=12)
    df.save(outcome, "pot.glb")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import breaker as breaker
    from .api import hit as hit
    from .api import load as load
    from .api import run as run
    from .api import save as save
    from .api import simulate as simulate
    from .api import stress as stress
    from .api import throw as throw
    from .api import throw_scene as throw_scene
    from .api import train as train
    from .breakers import BREAKERS as BREAKERS
    from .fracture import MATERIALS as MATERIALS
    from .fracture import material as material
    from .geometry import BUILTIN as BUILTIN
    from .types import BadInput as BadInput
    from .types import Breaker as Breaker
    from .types import FracturePattern as FracturePattern
    from .types import Fragment as Fragment
    from .types import Fragments as Fragments
    from .types import Grid as Grid
    from .types import Impact as Impact
    from .types import Material as Material
    from .types import Mesh as Mesh
    from .types import NoSolution as NoSolution
    from .types import Recording as Recording
    from .types import Shape as Shape
    from .types import Volume as Volume
    from .world import Ball as Ball
    from .world import Block as Block
    from .world import Floor as Floor
    from .world import Live as Live
    from .world import Outcome as Outcome
    from .world import Placed as Placed
    from .world import Scene as Scene
    from .world import load_scene as load_scene

__version__ = "0.1.0"

_HOMES = {
    "api": ("breaker", "hit", "load", "run", "save", "simulate", "stress", "throw", "throw_scene", "train"),
    "breakers": ("BREAKERS",),
    "fracture": ("MATERIALS", "material"),
    "geometry": ("BUILTIN",),
    "types": (
        "BadInput", "Breaker", "FracturePattern", "Fragment", "Fragments", "Grid", "Impact", "Material", "Mesh",
        "NoSolution", "Recording", "Shape", "Volume",
    ),
    "world": ("Ball", "Block", "Floor", "Live", "Outcome", "Placed", "Scene", "load_scene"),
}  # fmt: skip
"""What can be had from here, by the room that it lives in."""
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
