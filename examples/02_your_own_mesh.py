"""A mesh of your own: units, which way is up, repair, and pieces that come back where the file has them.

    python examples/02_your_own_mesh.py                       # a damaged scan of a mug, made here
    python examples/02_your_own_mesh.py statue.stl --up z     # yours

No unit has to be set. The program works on a body two metres long, whatever the file says: things break as large
things do, which is what one wants to see. What it writes is in the coordinates of the file again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from starting import start
from tyro.conf import Positional

import deepfracture as df
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import log

MILLIMETRES = 95.0
"""Height of the mug that is made here."""


def your_own_mesh(
    mesh: Annotated[Path | None, Positional] = None,
    *,
    out: Path = Path("runs/02_your_own_mesh"),
    up: str = "y",
    breaker: str = "physical",
    material: str = "ceramic",
    speed: float = 30,
    resolution: int = 64,
    seed: int = 0,
) -> None:
    """Break a mesh file; no training is needed.

    Args:
        mesh: OBJ, STL, PLY, GLB, GLTF or OFF; a damaged mug where none is given.
        out: folder.
        up: axis of the file that points up.
        breaker: how it breaks: physical, voronoi or cvd.
        material: how strong it is.
        speed: of the ball [m/s].
        resolution: voxels along each axis.
        seed: the same seed breaks the same way.
    """
    path = mesh or damaged_mug(out / "scan.obj")
    try:
        shape = df.load(path)
    except df.BadInput as problem:  # a hole, a flipped face, two shells: the message says which and how many
        log.info("%s", problem)
        shape = df.load(path, repair=True)

    breaks = df.breaker(breaker, shape, material=material, resolution=resolution)
    outcome = df.throw(shape, breaks, speed=speed, up=up, seed=seed)
    if not outcome.breaks:
        raise df.BadInput(f"{path}: a ball at {speed:g} m/s does not break it in {material}; throw faster")
    df.save(outcome, out / "animation.glb")
    df.save(outcome, out / "animation.png")
    df.save(outcome.breaks[0], out / "pieces")

    pieces = outcome.breaks[0].fragments or ()
    low, high = shape.to_user(shape.mesh.bounds)
    log.info("%d pieces within %s to %s of the file", len(pieces), low.round(3), high.round(3))


def damaged_mug(path: Path) -> Path:
    """The built-in mug as a careless scan: in millimetres, y up, some faces missing and some inside out."""
    mug = df.load("mug").mesh
    size = MILLIMETRES / float(np.ptp(mug.vertices[:, 2]))
    corners = mug.vertices[:, [0, 2, 1]] * [size, size, -size] + [120, 0, -40]
    faces = mug.faces.copy()
    faces[::50] = faces[::50, ::-1]
    faces = np.delete(faces, slice(1000, 1020), axis=0)
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in corners]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    with atomic_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    start(your_own_mesh)
