"""Train a model of your own shape, and see honestly how far it has come.

    python examples/05_train_your_own.py statue.obj --collisions 240 --minutes 8 --speed 8 30

Without arguments it is a small run on the letter A: enough to see every step, not enough to be good. Run the same
command again with more --collisions or --minutes, and it goes on where it stopped. The table at the end says what that
was worth: 1 is as good as a second simulation of the same collision with other weak places in the material, which
nobody can beat by much; `random` recalls any pattern at all.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from picturing import exploded_view, panel
from starting import start
from tyro.conf import Positional

import deepfracture as df
from deepfracture.breakers import make_source, open_patterns
from deepfracture.carve import cut
from deepfracture.dataset import Dataset
from deepfracture.evaluate import evaluate, write_report
from deepfracture.evaluate.report import score_table
from deepfracture.runtime.progress import log

OTHER = 1000
"""Added to the seed of the held-out collisions: none of them is in the training data."""


def train_your_own(
    shape: Annotated[str, Positional] = "letter_a",
    *,
    out: Path = Path("runs/05_train_your_own"),
    collisions: int = 40,
    held: int = 6,
    speed: tuple[float, float] = (6.0, 20.0),
    minutes: float = 1.5,
    resolution: int = 64,
    workers: int = 2,
    material: str = "plaster",
    repair: bool = False,
    size: tuple[int, int] = (300, 260),
    seed: int = 0,
) -> None:
    """Simulate, train, and compare with collisions that the model has not seen.

    Args:
        shape: a mesh file or a built-in name.
        out: folder: data, run/model.safetensors, evaluation/ and held_out.png.
        collisions: balls thrown for the training data.
        held: collisions to measure it on, each simulated twice.
        speed: slowest and fastest ball [m/s].
        minutes: of training.
        resolution: voxels along each axis.
        workers: processes.
        material: what it is made of.
        repair: mend the mesh first.
        size: width and height of each picture [pixel].
        seed: of everything that is drawn.
    """
    body = df.load(shape, repair=repair)
    chosen = {"speed": speed, "resolution": resolution, "workers": workers, "material": material}
    data = df.simulate(body, out / "data", collisions=collisions, seed=seed, **chosen)
    unseen = df.simulate(body, out / "held", collisions=held, repeats=2, seed=seed + OTHER, **chosen)
    model = df.train(data, out / "run", minutes=minutes, seed=seed)

    patterns = open_patterns(body, out / "data")
    stuff, grid = df.material(material), df.Grid(resolution)
    sources = {
        name: make_source(name, body, stuff, grid, patterns=patterns) for name in ("nearest", "random", "voronoi")
    }
    sources["learned"] = make_source("learned", body, stuff, grid, model=model)
    found = write_report(evaluate(unseen, sources, draws=2, seed=seed), out / "evaluation")
    log.info("%d patterns to learn from\n%s", len(data), score_table(found))
    side_by_side(unseen, df.breaker("learned", body, material=stuff, model=model), out / "held_out.png", size)


def side_by_side(held: Dataset, learned: df.Breaker, path: Path, size: tuple[int, int]) -> None:
    """The held-out collisions in rows: simulated, simulated again, predicted."""
    views = []
    for group in held.collisions():
        if len(group) < 2:  # in one of the two simulations it held
            continue
        impact = held[group[0]].impact
        simulated = [cut(held.shape, held[k].pattern, density=held.material.density) for k in group[:2]]
        predicted = learned(held.shape, impact, np.random.default_rng(0))
        made = zip(("simulated", "simulated again", "predicted"), [*simulated, predicted], strict=True)
        for name, fragments in made:
            if fragments is None:
                raise df.BadInput(f"the model leaves a blow of {impact.magnitude[0]:.0f} N s whole; train it longer")
            views.append((exploded_view(fragments, held.shape, size), f"{name}: {len(fragments)} fragments"))
    if not views:
        raise df.BadInput("no held-out collision broke the shape twice; throw faster (--speed) or more (--held)")
    panel(views, path, columns=3)


if __name__ == "__main__":
    start(train_your_own)
