"""deepfracture: brittle fracture, simulated and learned, inside a rigid-body simulation.

What `deepfracture.api` and `deepfracture.types` define is found here too, loaded when it is first asked for:

    import deepfracture as df

    pot = df.load("pot")
    outcome = df.throw(pot, df.breaker("learned", pot), speed=12)
    df.save(outcome, "pot.glb")
"""

from typing import TYPE_CHECKING

from deepfracture._version import __version__ as __version__
from deepfracture.runtime.lazy import lazy_names

if TYPE_CHECKING:
    from deepfracture.api import breaker as breaker
    from deepfracture.api import hit as hit
    from deepfracture.api import load as load
    from deepfracture.api import run as run
    from deepfracture.api import save as save
    from deepfracture.api import simulate as simulate
    from deepfracture.api import stress as stress
    from deepfracture.api import throw as throw
    from deepfracture.api import throw_scene as throw_scene
    from deepfracture.api import train as train
    from deepfracture.breakers import BREAKERS as BREAKERS
    from deepfracture.breakers import BreakerOptions as BreakerOptions
    from deepfracture.dataset import SimulateOptions as SimulateOptions
    from deepfracture.fracture import MATERIALS as MATERIALS
    from deepfracture.fracture import material as material
    from deepfracture.geometry import BUILTIN as BUILTIN
    from deepfracture.learn import TrainOptions as TrainOptions
    from deepfracture.types import BadInput as BadInput
    from deepfracture.types import Breaker as Breaker
    from deepfracture.types import FracturePattern as FracturePattern
    from deepfracture.types import Fragment as Fragment
    from deepfracture.types import Fragments as Fragments
    from deepfracture.types import Grid as Grid
    from deepfracture.types import Impact as Impact
    from deepfracture.types import Material as Material
    from deepfracture.types import Mesh as Mesh
    from deepfracture.types import NoSolution as NoSolution
    from deepfracture.types import Recording as Recording
    from deepfracture.types import Shape as Shape
    from deepfracture.types import Volume as Volume
    from deepfracture.world import Ball as Ball
    from deepfracture.world import Block as Block
    from deepfracture.world import Floor as Floor
    from deepfracture.world import Live as Live
    from deepfracture.world import Outcome as Outcome
    from deepfracture.world import Placed as Placed
    from deepfracture.world import Scene as Scene
    from deepfracture.world import load_scene as load_scene

_HOMES = {
    "api": ("breaker", "hit", "load", "run", "save", "simulate", "stress", "throw", "throw_scene", "train"),
    "breakers": ("BREAKERS", "BreakerOptions"),
    "dataset": ("SimulateOptions",),
    "fracture": ("MATERIALS", "material"),
    "geometry": ("BUILTIN",),
    "learn": ("TrainOptions",),
    "types": (
        "BadInput", "Breaker", "FracturePattern", "Fragment", "Fragments", "Grid", "Impact", "Material", "Mesh",
        "NoSolution", "Recording", "Shape", "Volume",
    ),
    "world": ("Ball", "Block", "Floor", "Live", "Outcome", "Placed", "Scene", "load_scene"),
}  # fmt: skip
"""Public names, by the module that defines them."""
_HOME = {name: home for home, names in _HOMES.items() for name in names}
__getattr__, __dir__ = lazy_names(__name__, _HOMES)
