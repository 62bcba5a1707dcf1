"""Throw many balls at a shape and simulate what breaks, on all processors, continuing after a kill."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TypeAlias

import numpy as np

from deepfracture.dataset.store import (
    Dataset,
    Sample,
    Settings,
    create,
    done,
    open_dataset,
    write_failed,
    write_sample,
    write_unbroken,
)
from deepfracture.progress import hush, log, track
from deepfracture.types import BadInput, FracturePattern, Grid, Impact, Material, NoSolution, Shape
from deepfracture.words import meant

THREAD_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one collision did."""

    impact: Impact | None
    """None: the ball missed."""
    pattern: FracturePattern | None
    """None: nothing broke."""


Collide: TypeAlias = Callable[[np.random.Generator, np.random.Generator | None], Outcome]
"""One random collision, a function of the generators alone: the first draws the scene, the second, or what the
scene has left of the first, the material."""


def simulate_collisions(
    shape: Shape,
    material: Material,
    out: Path | str,
    *,
    collisions: int,
    workers: int,
    resolution: int,
    seed: int,
    speed_range: tuple[float, float],
    scene: str = "single",
    refracture: int = 0,
    frames: int = 60,
    repeats: int = 1,
    prepare: Callable[[Settings], Collide] | None = None,
) -> Dataset:
    """Simulate collisions 0 .. `collisions` - 1 that the folder `out` does not hold yet.

    Collision k depends on (`seed`, k) alone, so the samples are the same, byte for byte, however many
    workers there are and however often the job was interrupted.

    Args:
        collisions: Balls thrown in all; those that break nothing, or that the solver cannot take, are counted
            and left out.
        speed_range: Slowest and fastest ball [m/s].
        scene: Kind of scene, one of `world.KINDS`.
        refracture: Generations of fragments that may break again ...
        frames: ... within so many frames, at 60 a second, after the hit.
        repeats: Times that each collision is simulated: the same ball and the same impact, another draw of the
            material's weak places. The first repeats are the collisions of a data set without repeats.
        prepare: What makes the collision of the settings, once in every worker; by default a ball in
            the rigid-body world and the fracture simulator.

    Raises:
        BadInput: A value makes no sense, or `out` was made with other settings.
    """
    from deepfracture.world import KINDS

    if collisions < 1 or workers < 1:
        raise BadInput(f"collisions and workers must be at least 1, got {collisions} and {workers}")
    slow, fast = speed_range
    if not 0 < slow <= fast:
        raise BadInput(f"speed_range must be positive and ascending, got {speed_range}")
    if scene not in KINDS:
        raise BadInput(f"scene must be one of {', '.join(KINDS)}, got {scene!r}{meant(scene, KINDS)}")
    if refracture < 0 or frames < 1:
        raise BadInput(f"refracture must be 0 or more and frames at least 1, got {refracture} and {frames}")
    if repeats < 1:
        raise BadInput(f"repeats must be at least 1, got {repeats}")
    speeds = (float(slow), float(fast))
    # Without re-fracture nothing happens after the hit: then the frames are no part of the settings.
    again = (refracture, frames if refracture else 0, repeats)
    settings = Settings(shape, material, Grid(resolution).resolution, seed, speeds, scene, *again)
    out = Path(out)
    create(out, settings)
    missing = sorted(set(range(collisions * repeats)) - done(out))
    if missing:
        _run(out, settings, prepare or physical_collisions, missing, min(workers, len(missing)))
    return open_dataset(out)


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


def collision_seed(seed: int, k: int) -> int:
    """The seed of collision `k`: independent streams however close the numbers are."""
    return int(np.random.SeedSequence([seed, k]).generate_state(1, np.uint64)[0])


def _run(
    out: Path, settings: Settings, prepare: Callable[[Settings], Collide], missing: list[int], workers: int
) -> None:
    with (
        _one_thread_each(),
        ProcessPoolExecutor(workers, get_context("spawn"), _start, (out, settings, prepare)) as pool,
    ):
        try:
            futures = [pool.submit(_collide, k) for k in missing]
            for future in track(as_completed(futures), name="collisions", total=len(futures)):
                future.result()
        except BrokenProcessPool as error:
            raise RuntimeError(f"{out}: a worker died, perhaps for lack of memory; run again to go on") from error
        finally:  # on an error or Ctrl-C drop what has not started; what runs is still stored
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Children read these variables when they start; one thread each is quickest and always sums alike."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_worker: tuple[Path, Settings, Collide] | None = None
"""State of a worker process, set once when it starts."""


def _start(out: Path, settings: Settings, prepare: Callable[[Settings], Collide]) -> None:
    global _worker
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent: let a collision finish
    hush()  # the parent shows how far all of them are
    _worker = (out, settings, prepare(settings))


def _leave_with(parent: int) -> None:
    """End this process when the parent has been killed: nobody would collect what it does."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _collide(entry: int) -> None:
    assert _worker is not None
    out, settings, collide = _worker
    k, repeat = divmod(entry, settings.repeats)
    seed = collision_seed(settings.seed, k)
    again = np.random.default_rng([seed, repeat]) if repeat else None
    try:
        outcome = collide(np.random.default_rng(seed), again)
    except (NoSolution, BadInput) as problem:  # of this one collision: the others need not suffer
        log.warning("%s: collision %d passed over: %s", out, entry, problem)
        write_failed(out, entry, str(problem), seed)
        return
    if outcome.impact is None or outcome.pattern is None:
        write_unbroken(out, entry, outcome.impact, seed)
    else:
        write_sample(out, entry, Sample(outcome.impact, outcome.pattern, seed))
