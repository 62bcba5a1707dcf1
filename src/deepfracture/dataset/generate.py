"""Throw many balls at a shape and simulate what breaks, on many processors, continuing after a kill."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from pathlib import Path

import numpy as np

from deepfracture.dataset.arrays import CAPACITY
from deepfracture.dataset.executors import Executor, Local
from deepfracture.dataset.guard import Collide, Job, Outcome
from deepfracture.dataset.storage import Folder
from deepfracture.dataset.store import Dataset, Settings, create, done, forget, open_dataset
from deepfracture.runtime.progress import log, track
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Grid, Material, Shape

LIMIT = 600.0
"""Seconds after which a collision is given up, if nobody says otherwise."""


def simulate_collisions(
    shape: Shape,
    material: Material,
    out: Path | str,
    *,
    collisions: int,
    resolution: int,
    seed: int,
    speed_range: tuple[float, float],
    scene: str = "single",
    refracture: int = 0,
    frames: int = 60,
    repeats: int = 1,
    executor: Executor = Local(2),  # noqa: B008  (frozen)
    limit: float = LIMIT,
    memory: float | None = None,
    retry: bool = False,
    prepare: Callable[[Settings], Collide] | None = None,
) -> Dataset:
    """Simulate collisions 0 .. `collisions` - 1 that the data set `out` does not hold yet.

    Collision k depends on (`seed`, k) alone, so the samples are the same, byte for byte, however many
    workers there are on however many machines, and however often the job was interrupted.

    Args:
        out: Folder, or s3://BUCKET/PREFIX.
        collisions: Balls thrown in all; those that break nothing, or that the solver cannot take, are counted
            and left out.
        speed_range: Slowest and fastest ball [m/s].
        scene: Kind of scene, one of `world.KINDS`.
        refracture: Generations of fragments that may break again ...
        frames: ... within so many frames, at 60 a second, after the hit.
        repeats: Times that each collision is simulated: the same ball and the same impact, another draw of the
            material's weak places. The first repeats are the collisions of a data set without repeats.
        executor: Who does it.
        limit: Seconds that a collision, or getting ready for them, may take ...
        memory: ... and gigabytes that a worker may take (None: all that there is): else it counts as failed.
        retry: First drop what failed or is damaged, and do it again.
        prepare: What makes the collision of the settings, once in every worker; by default a ball in
            the rigid-body world and the fracture simulator.

    Raises:
        BadInput: A value makes no sense, or `out` was made with other settings or cannot be written.
        NoSolution: The shape cannot be prepared within the limits.
    """
    from deepfracture.world import KINDS

    if collisions < 1:
        raise BadInput(f"collisions must be at least 1, got {collisions}")
    slow, fast = speed_range
    if not 0 < slow <= fast:
        raise BadInput(f"speed_range must be positive and ascending, got {speed_range}")
    if scene not in KINDS:
        raise BadInput(f"scene must be one of {', '.join(KINDS)}, got {scene!r}{did_you_mean(scene, KINDS)}")
    if refracture < 0 or frames < 1:
        raise BadInput(f"refracture must be 0 or more and frames at least 1, got {refracture} and {frames}")
    if repeats < 1:
        raise BadInput(f"repeats must be at least 1, got {repeats}")
    if collisions * repeats > CAPACITY:
        raise BadInput(f"a data set holds up to {CAPACITY} entries, got {collisions} collisions, {repeats} times each")
    _check_limits(limit, memory)
    speeds = (float(slow), float(fast))
    # Without re-fracture nothing happens after the hit: then the frames are no part of the settings.
    again = (refracture, frames if refracture else 0, repeats)
    settings = Settings(shape, material, Grid(resolution).resolution, seed, speeds, scene, *again)
    storage = create(out, settings)
    if retry and (dropped := forget(storage)):
        log.info("%s: %d entries that failed or are damaged are simulated again", storage.place, dropped)
    missing = sorted(set(range(collisions * repeats)) - done(storage))
    if missing:
        place = str(storage.root.resolve()) if isinstance(storage, Folder) else storage.place
        limits = limit, math.inf if memory is None else memory
        job = Job(uuid.uuid4().hex, place, settings, prepare or physical_collisions, *limits)
        for _ in track(executor.run(job, missing), name="collisions", total=len(missing)):
            pass
    return open_dataset(storage)


def _check_limits(limit: float, memory: float | None) -> None:
    if not limit > 0:
        raise BadInput(f"limit must be positive, got {limit}")
    if memory is not None and not 0 < memory < math.inf:
        raise BadInput(f"memory must be positive, got {memory}")
    if memory is not None and not Path("/proc/self/statm").exists():
        raise BadInput(f"memory {memory:g}: only Linux says how much a process takes; leave it out")


def physical_collisions(settings: Settings) -> Collide:
    """A random scene of the settings' kind in the rigid-body world, then the fracture simulator."""
    from deepfracture.dataset.refracture import broken_again
    from deepfracture.fracture import prepare_body, simulate
    from deepfracture.world import draw_scene, joint_impact

    shape, material = settings.shape, settings.material
    body = prepare_body(shape, material, Grid(settings.resolution))

    def collide(rng: np.random.Generator, material_rng: np.random.Generator | None = None) -> Outcome:
        scene = draw_scene(
            settings.scene, shape, rng, material=material.name, speed=settings.speed_range, seed=settings.seed
        )
        impact = joint_impact(scene, shape, materials={material.name: material})
        rng = material_rng or rng
        cracking = None if impact is None else simulate(body, impact, rng)
        if cracking is None:
            return Outcome(impact, None)
        pattern, generations = cracking.pattern, settings.refracture
        if generations:
            frames = settings.frames
            pattern = broken_again(scene, shape, material, pattern, rng, frames=frames, generations=generations)
        return Outcome(impact, pattern)

    return collide
