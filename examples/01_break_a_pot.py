"""Load, hit, break, save: a pot in ten lines, and then the same pot in a world that has a floor.

python examples/01_break_a_pot.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from starting import start

import deepfracture as df


def break_a_pot(
    out: Path = Path("runs/01_break_a_pot"), *, impulse: float = 2500, speed: float = 12, seed: int = 0
) -> None:
    """Break the built-in pot: pieces, their exploded view, and an animation.

    Args:
        out: folder.
        impulse: of the blow [N s].
        speed: of the ball that is thrown [m/s].
        seed: the same seed breaks the same way.
    """
    pot = df.load("pot")
    breaker = df.breaker("learned", pot, material="plaster")

    # One blow, and what it makes of the pot. Points are metres in the body frame: the pot is 2 m high.
    blow = df.hit(pot, point=(1, 0, 0.3), direction=(-1, 0, 0), impulse=impulse, speed=10)
    fragments = breaker(pot, blow, np.random.default_rng(seed))
    df.save(fragments, out / "pieces", shape=pot)
    df.save(fragments, out / "pieces.png", shape=pot)

    # A ball, gravity and a floor: everything moves until it lies still.
    outcome = df.throw(pot, breaker, speed=speed, seed=seed)
    df.save(outcome, out / "pot.glb")
    df.save(outcome, out / "pot.png")


if __name__ == "__main__":
    start(break_a_pot)
