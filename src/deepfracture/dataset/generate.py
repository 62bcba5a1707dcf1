"""Fill a data set with simulated collisions, on many processors, resuming after a kill."""

from __future__ import annotations

import math
import uuid
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from deepfracture.dataset.arrays import CAPACITY
from deepfracture.dataset.dataset import Dataset, discard_incomplete, open_dataset
from deepfracture.dataset.entries import recorded
from deepfracture.dataset.executors import Executor, Local
from deepfracture.dataset.settings import DatasetSettings, create_dataset
from deepfracture.dataset.storage import Folder
from deepfracture.dataset.watchdog import CollisionResult, Job, Simulator
from deepfracture.runtime.progress import log, track
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Grid, Material, Shape

TIME_LIMIT = 600.0
"""Default longest time for a collision [s]."""


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
    limit: float = TIME_LIMIT,
    memory: float | None = None,
    retry: bool = False,
    make_simulator: Callable[[DatasetSettings], Simulator] | None = None,
) -> Dataset:
    """Simulate collisions 0 .. `collisions` - 1 that the data set `out` does not hold yet.

    Collision k depends on (`seed`, k) alone: the samples are the same, byte for byte, for any number of workers and
    machines, and after any interruption.

    Args:
        out: Folder, or s3://BUCKET/PREFIX.
        collisions: Number of collisions; those without fracture, or that the solver cannot handle, are recorded
            without a pattern.
        speed_range: Slowest and fastest ball [m/s].
        scene: Kind of scene, one of `world.KINDS`.
        refracture: Generations of fragments that may break again ...
        frames: ... within this many frames after the hit, at 60 a second.
        repeats: Simulations of each collision: the same ball and impact, another realisation of the material's
            strength. The first repeats are the collisions of a data set without repeats.
        executor: Where the entries are simulated.
        limit: Longest time for a collision, and for the preparation of a worker [s]; beyond it an entry fails.
        memory: Largest memory of a worker [GB] (None: unlimited); beyond it an entry fails.
        retry: Simulate failed and damaged entries again.
        make_simulator: Makes the simulator of the settings, once in every worker; by default
            `physical_simulator`.

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
    # Without re-fracture the frames after the hit do not matter and are no part of the settings.
    again = (refracture, frames if refracture else 0, repeats)
    settings = DatasetSettings(shape, material, Grid(resolution).resolution, seed, speeds, scene, *again)
    storage = create_dataset(out, settings)
    if retry and (discarded := discard_incomplete(storage)):
        log.info("%s: %d failed or damaged entries are simulated again", storage.location, discarded)
    missing = sorted(set(range(collisions * repeats)) - recorded(storage))
    if missing:
        location = str(storage.root.resolve()) if isinstance(storage, Folder) else storage.location
        limits = limit, math.inf if memory is None else memory
        job = Job(uuid.uuid4().hex, location, settings, make_simulator or physical_simulator, *limits)
        for _ in track(executor.run(job, missing), name="collisions", total=len(missing)):
            pass
    dataset = open_dataset(storage)
    failures = Counter(record.reason for record in dataset.records if record.kind == "failed")
    for reason, count in failures.most_common():
        log.warning("%s: %d of %d collisions failed: %s", dataset.path, count, dataset.tried, reason)
    return dataset


def _check_limits(limit: float, memory: float | None) -> None:
    if not limit > 0:
        raise BadInput(f"limit must be positive, got {limit}")
    if memory is not None and not 0 < memory < math.inf:
        raise BadInput(f"memory must be positive, got {memory}")
    if memory is not None and not Path("/proc/self/statm").exists():
        raise BadInput(f"memory {memory:g}: only Linux reports the memory of a process; leave it out")


def physical_simulator(settings: DatasetSettings) -> Simulator:
    """Random scenes of the settings' kind in the rigid-body world, then the fracture simulator."""
    from deepfracture.dataset.refracture import refracture
    from deepfracture.fracture import prepare_body, simulate
    from deepfracture.world import draw_scene, joint_impact

    shape, material = settings.shape, settings.material
    body = prepare_body(shape, material, Grid(settings.resolution))

    def collide(rng: np.random.Generator, material_rng: np.random.Generator | None = None) -> CollisionResult:
        scene = draw_scene(
            settings.scene, shape, rng, material=material.name, speed=settings.speed_range, seed=settings.seed
        )
        impact = joint_impact(scene, shape, materials={material.name: material})
        rng = material_rng or rng
        cracking = None if impact is None else simulate(body, impact, rng)
        if cracking is None:
            return CollisionResult(impact, None)
        pattern, generations = cracking.pattern, settings.refracture
        if generations:
            frames = settings.frames
            pattern = refracture(scene, shape, material, pattern, rng, frames=frames, generations=generations)
        return CollisionResult(impact, pattern)

    return collide
