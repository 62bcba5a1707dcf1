"""Opens a rigid-body engine by its name."""

from __future__ import annotations

from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, ContactMaterial
from deepfracture.world.engine import Engine

ENGINES = ("bullet", "rapier")


def open_engine(name: str, *, gravity: float, contact: ContactMaterial) -> Engine:
    """An empty world with `gravity` [m/s^2] along -z. BadInput: no such engine, or it is not installed."""
    if name == "bullet":
        from deepfracture.world.bullet import Bullet

        return Bullet(gravity, contact)
    if name == "rapier":
        from deepfracture.world.rapier import Rapier

        return Rapier(gravity, contact)
    raise BadInput(f"engine must be one of {', '.join(ENGINES)}, got {name!r}{did_you_mean(name, ENGINES)}")
