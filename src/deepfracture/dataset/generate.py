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
from deepfracture.dataset.executors import Executor, make_executor
from deepfracture.dataset.options import SimulateOptions
from deepfracture.dataset.settings import DatasetSettings, create_dataset
from deepfracture.dataset.storage import Folder
from deepfracture.dataset.watchdog import CollisionResult, Job, Simulator
from deepfracture.runtime.progress import log, track
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Grid, Material, Shape


def simulate_collisions(
    shape: Shape,
    material: Material,
    out: Path | str,
    options: SimulateOptions,
    *,
    executor: Executor | None = None,
    make_simulator: Callable[[DatasetSettings], Simulator] | None = None,
) -> Dataset:
    """Simulate the collisions that `options` asks for and the data set `out` does not hold yet.

    Collision k depends on (seed, k) alone: the samples are the same, byte for byte, for any number of workers and
    machines, and after any interruption.

    Args:
        out: Folder, or s3://BUCKET/PREFIX.
        options: Collisions without fracture, or that the solver cannot handle, are recorded without a pattern.
            `repeats` simulates the same ball and impact with another realisation of the material's strength; the
            first repeats are the collisions of a data set without repeats. `limit` and `memory` hold for the
            preparation of a worker too.
        executor: Where the entries are simulated, instead of the one that `options` names.
        make_simulator: Makes the simulator of the settings, once in every worker; by default
            `physical_simulator`.

    Raises:
        BadInput: A value makes no sense, or `out` was made with other settings or cannot be written.
        NoSolution: The shape cannot be prepared within the limits.
    """
    _check(options)
    if executor is None:
        executor = make_executor(options.executor, workers=options.workers, address=options.address)
    settings = DatasetSettings(
        shape, material, Grid(options.resolution).resolution, options.seed,
        (float(options.speed[0]), float(options.speed[1])), options.scene, options.refracture,
        options.frames if options.refracture else 0,  # without refracture nothing happens after the hit
        options.repeats,
    )  # fmt: skip
    storage = create_dataset(out, settings)
    if options.retry and (discarded := discard_incomplete(storage)):
        log.info("%s: %d failed or damaged entries are simulated again", storage.location, discarded)
    missing = sorted(set(range(options.collisions * options.repeats)) - recorded(storage))
    if missing:
        location = str(storage.root.resolve()) if isinstance(storage, Folder) else storage.location
        limits = options.limit, math.inf if options.memory is None else options.memory
        job = Job(uuid.uuid4().hex, location, settings, make_simulator or physical_simulator, *limits)
        for _ in track(executor.run(job, missing), name="collisions", total=len(missing)):
            pass
    dataset = open_dataset(storage)
    failures = Counter(record.reason for record in dataset.records if record.kind == "failed")
    for reason, count in failures.most_common():
        log.warning("%s: %d of %d collisions failed: %s", dataset.path, count, dataset.tried, reason)
    return dataset


def _check(options: SimulateOptions) -> None:
    """Raise BadInput for a value that makes no sense."""
    from deepfracture.world import KINDS

    collisions, repeats, scene, memory = options.collisions, options.repeats, options.scene, options.memory
    if collisions < 1:
        raise BadInput(f"collisions must be at least 1, got {collisions}")
    slow, fast = options.speed
    if not 0 < slow <= fast:
        raise BadInput(f"speed must be positive and ascending, got {options.speed}")
    if scene not in KINDS:
        raise BadInput(f"scene must be one of {', '.join(KINDS)}, got {scene!r}{did_you_mean(scene, KINDS)}")
    if options.refracture < 0 or options.frames < 1:
        raise BadInput(
            f"refracture must be 0 or more and frames at least 1, got {options.refracture} and {options.frames}"
        )
    if repeats < 1:
        raise BadInput(f"repeats must be at least 1, got {repeats}")
    if collisions * repeats > CAPACITY:
        raise BadInput(f"a data set holds up to {CAPACITY} entries, got {collisions} collisions, {repeats} times each")
    if not options.limit > 0:
        raise BadInput(f"limit must be positive, got {options.limit}")
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
