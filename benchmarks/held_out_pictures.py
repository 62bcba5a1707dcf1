"""Pictures of held-out collisions: simulated, simulated again with another draw of the material, and predicted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from contact_sheet import azimuth_of, grid_of, save
from harness import ROOT, start

from deepfracture.breakers import PatternSource, ablations
from deepfracture.carve import cut
from deepfracture.dataset import Dataset, open_dataset
from deepfracture.render.picture import exploded
from deepfracture.runtime.progress import track
from deepfracture.types import BadInput, FracturePattern, Impact

COLUMNS = ("simulation", "simulated again", "random code 1", "random code 2", "nearest pattern")


def held_out_pictures(
    held: Annotated[Path, tyro.conf.Positional],
    model: Annotated[Path, tyro.conf.Positional],
    dataset: Annotated[Path, tyro.conf.Positional],
    /,
    collisions: int = 5,
    size: tuple[int, int] = (300, 260),
    factor: float = 0.35,
    out: Path = ROOT / "runs" / "held_out",
    sheet: Path = ROOT / "runs" / "held_out" / "sheet.png",
) -> Path:
    """Exploded pictures, a held-out collision in each row, from the weakest to the strongest.

    Args:
        held: held-out collisions, made with --repeats.
        model: trained weights.
        dataset: what they were trained on.
        collisions: rows, spread over the impulses.
        size: width and height of one picture [pixel].
        factor: how far fragments move outwards, as a share of their distance from the middle.
        out: folder of the single pictures.
        sheet: the PNG to write.
    """
    unseen, taught = open_dataset(held), open_dataset(dataset)
    groups = [group for group in unseen.collisions() if len(group) > 1]
    if not 0 < collisions <= len(groups):
        raise BadInput(f"collisions must be 1 to {len(groups)}, got {collisions}")
    impacts = unseen.impacts()
    groups.sort(key=lambda group: impacts[group[0]].magnitude[0])
    chosen = [groups[k] for k in np.linspace(0, len(groups) - 1, collisions).round().astype(int)]
    learned = ablations(unseen.shape, unseen.material, model)[""]
    cells: list[list[tuple[Path, str]]] = []
    for group in track(chosen, name="collisions"):
        impact = impacts[group[0]]
        row = []
        for name, pattern in zip(COLUMNS, patterns(unseen, taught, group, learned), strict=True):
            path = out / f"{unseen.shape.name}-{group[0]:04d}-{name.replace(' ', '_')}.png"
            pieces = cut(unseen.shape, pattern, density=unseen.material.density)
            exploded(pieces, path, factor=factor, size=size, azimuth=azimuth_of(impact))
            row.append((path, f"{name}\n{impact.magnitude[0]:.0f} N s, {len(pieces)} fragments"))
        cells.append(row)
    save(grid_of(cells, size), sheet)
    return sheet


def patterns(held: Dataset, taught: Dataset, group: tuple[int, ...], learned: PatternSource) -> list[FracturePattern]:
    """In the order of COLUMNS."""
    first, second = (held[index] for index in group[:2])
    drawn = [learned(held.shape, first.impact, np.random.default_rng([draw, group[0]])) for draw in range(2)]
    found = [first.pattern, second.pattern, *(pattern for pattern in drawn if pattern is not None)]
    if len(found) < 4:
        raise BadInput(f"{held.path}: the model holds in collision {group[0]}; there is nothing to draw")
    return [*found, taught[_nearest(first.impact, taught)].pattern]


def _nearest(impact: Impact, taught: Dataset) -> int:
    from deepfracture.learn import normalise_impact

    rows = np.stack([normalise_impact(known, taught.max_impulse) for known in taught.impacts()])
    return int(((rows - normalise_impact(impact, taught.max_impulse)) ** 2).sum(axis=1).argmin())


if __name__ == "__main__":
    start(held_out_pictures)
