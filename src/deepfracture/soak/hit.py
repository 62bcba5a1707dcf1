"""One hit, from the ball to the fragments on the floor, and the checks of its result."""

from __future__ import annotations

import time
import traceback
import zlib
from collections import Counter
from collections.abc import Hashable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deepfracture.breakers import PatternBreaker, make_source
from deepfracture.breakers.base import PatternSource
from deepfracture.breakers.physical import Physical
from deepfracture.breakers.refracture import fragment_grid
from deepfracture.breakers.registry import open_patterns
from deepfracture.fracture import MATERIALS, FractureBody
from deepfracture.geometry import load_shape
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.runtime.lru import LRU
from deepfracture.runtime.memory import release_free_memory, resident_mb
from deepfracture.soak.plan import DATASET_BREAKERS, Case, SoakOptions, data_of, model_of
from deepfracture.soak.scenes import draw_scene
from deepfracture.types import Breaker, Fragments, Grid, Impact, NoSolution, Recording, Shape, Track
from deepfracture.validation.fragments import check_fragments
from deepfracture.world import Live, Scene

CACHE_SIZE = 16
"""Models, stress solvers (120 MB) and data sets kept of each kind, the most recently used."""
LIGHT_CACHE_SIZE = 64
"""Breakers without any of these: a distance field of 1 MB each."""
FLOOR_TOLERANCE = 0.1
"""Depth that a corner of a body may penetrate the floor [m]: a body struck against it may yield a little."""


@dataclass
class TimedBreaker:
    """A breaker that records its results, what it broke and how long it took."""

    breaker: Breaker
    answers: list[tuple[Shape, Fragments]] = field(default_factory=list)
    asked: int = 0
    seconds: float = 0.0

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> Fragments | None:
        began = time.perf_counter()
        found = self.breaker(shape, impact, rng)
        self.seconds += time.perf_counter() - began
        self.asked += 1
        if found is not None:
            self.answers.append((shape, found))
        return found


class ShapesAndBreakers:
    """Shapes and breakers of a soak, cached from hit to hit; what is computed for fragments is not."""

    def __init__(self, options: SoakOptions) -> None:
        self.options = options
        self._shapes: dict[str, Shape] = {}
        self._bodies: LRU[str, FractureBody] = LRU(CACHE_SIZE)
        self._memories: LRU[Hashable, Any] = LRU(CACHE_SIZE)
        self._known: LRU[Hashable, PatternSource] = LRU(CACHE_SIZE)
        self._light: LRU[Hashable, PatternSource] = LRU(LIGHT_CACHE_SIZE)

    def shape(self, source: str) -> Shape:
        if source not in self._shapes:
            self._shapes[source] = load_shape(source, repair=self.options.repair)
        return self._shapes[source]

    def material(self, one: Case, rng: np.random.Generator) -> str:
        """Material of a hit: fixed where a stress solver or stored patterns are for a single one."""
        if one.breaker == "learned" or one.breaker in DATASET_BREAKERS:
            return "plaster"
        names = tuple(MATERIALS)
        if one.breaker == "physical":
            return names[zlib.crc32(Path(one.shape).stem.encode()) % len(names)]
        return str(rng.choice(names))

    def breaker(self, one: Case, material: str) -> Breaker:
        shape, made_of, grid = self.shape(one.shape), MATERIALS[material], Grid(one.resolution)
        if one.breaker == "physical":
            body = self._bodies.get(one.shape, lambda: Physical(made_of, grid).body(shape))
            return PatternBreaker(Physical(made_of, grid, {shape: body}), made_of)

        def make() -> PatternSource:
            data = data_of(one.shape, self.options) if one.breaker in DATASET_BREAKERS else None
            patterns = None if data is None else self._memories.get(data, lambda: open_patterns(shape, data))
            model = model_of(one.shape, self.options) if one.breaker == "learned" else None
            return make_source(one.breaker, shape, made_of, grid, model=model, patterns=patterns)

        kept = self._known if one.breaker == "learned" or one.breaker in DATASET_BREAKERS else self._light
        return PatternBreaker(kept.get((one.shape, one.breaker, material), make), made_of)


@dataclass(frozen=True)
class PreparedHit:
    """A hit ready to be simulated."""

    case: Case
    scene: Scene
    shape: Shape
    breaker: TimedBreaker


def prepare(resources: ShapesAndBreakers, one: Case) -> PreparedHit:
    """Shape, breaker and scene of a hit."""
    rng = np.random.default_rng(one.seed)
    material = resources.material(one, rng)
    shape = resources.shape(one.shape)
    breaker = TimedBreaker(resources.breaker(one, material))
    scene = draw_scene(one.shape, shape, rng, material=material, breaker=one.breaker, engine=resources.options.engine)
    return PreparedHit(one, scene, shape, breaker)


@dataclass(frozen=True)
class SimulatedHit:
    """A simulated hit, not yet checked."""

    ready: PreparedHit
    row: dict[str, Any]
    """Its results so far."""
    recording: Recording | None
    """None if the simulation failed."""


def hit(ready: PreparedHit) -> dict[str, Any]:
    """Simulate and check: a row of results, whose `failures` are empty if all checks pass."""
    return check(play(ready))


def play(ready: PreparedHit) -> SimulatedHit:
    """Simulate a hit from the first frame to the last."""
    watched, recording = ready.breaker, None
    row: dict[str, Any] = {**asdict(ready.case), "failures": {}}
    began, worked = time.perf_counter(), time.process_time()
    try:
        recording, broken = _play(ready)
        row |= {"breaks": broken, "frames": recording.frames, "asked": watched.asked, "break_seconds": watched.seconds}
    except _NotFinite as problem:
        row |= {"failures": {"pose": 1}, "detail": str(problem)}
    except Exception as crash:  # a soak reports crashes
        row |= _crash(crash)
    taken = {"seconds": time.perf_counter() - began, "processor_seconds": time.process_time() - worked}
    return SimulatedHit(ready, row | taken, recording)


def check(played: SimulatedHit) -> dict[str, Any]:
    """The row of a hit, with the failures of its checks."""
    row, ready = dict(played.row), played.ready
    if played.recording is not None:
        try:
            row |= _fragments(ready.breaker, ready.case.resolution) | _bodies(played.recording, ready.scene)
            if row["through"]:
                row["failures"]["through floor"] = row["through"]
        except Exception as crash:
            row |= _crash(crash)
    release_free_memory()  # measure what is held, not the peak of the largest scene
    return row | {"resident_mb": resident_mb()}


def _crash(crash: Exception) -> dict[str, Any]:
    kind = "no solution" if isinstance(crash, NoSolution) else "crash"
    detail = f"{type(crash).__name__}: {(str(crash).splitlines() or [''])[0]}"
    return {"failures": {kind: 1}, "detail": detail, "traceback": traceback.format_exc()}


class _NotFinite(RuntimeError):
    """A body has a pose that is not finite."""


def _play(ready: PreparedHit) -> tuple[Recording, int]:
    """The recording, and the number of collisions with fracture."""
    scene = ready.scene
    rng = np.random.default_rng([ready.case.seed, 1])
    with Live(scene, [ready.shape], ready.breaker, rng, materials=MATERIALS) as live:
        for _ in range(int(scene.duration * scene.frame_rate)):
            live.advance()
            for pose in live.at(live.frames - 1):
                if not (np.isfinite(pose.position).all() and np.isfinite(pose.quat_wxyz).all()):
                    raise _NotFinite(f"{pose.name} has no finite pose in frame {live.frames - 1}")
            if live.at_rest:
                break
        outcome = live.outcome()
    return outcome.recording, len(outcome.breaks)


def _fragments(watched: TimedBreaker, resolution: int) -> dict[str, Any]:
    """Failed checks of the fragments of whole shapes and of fragments broken again."""
    failures: Counter[str] = Counter()
    error, count = 0.0, 0
    for shape, fragments in watched.answers:
        whole = Grid(resolution)
        voxel = whole.spacing if shape.whole is None else fragment_grid(shape, whole).spacing
        report = check_fragments(shape, fragments, voxel=voxel)
        failures.update(report.failures)
        error, count = max(error, abs(report.volume_error)), count + len(fragments)
    again = sum(shape.whole is not None for shape, _ in watched.answers)
    return {"failures": dict(failures), "fragments": count, "again": again, "volume_error": error}


def _bodies(recording: Recording, scene: Scene) -> dict[str, Any]:
    """Deepest penetration of the floor [m] and greatest speed of a fragment [m/s].

    A body is through the floor if its centre of mass is below it, or a corner by more than `FLOOR_TOLERANCE`."""
    bodies = [track for track in recording.tracks if track.rigid is not None]
    speeds = [np.linalg.norm(t.rigid.velocities, axis=1).max() for t in bodies if t.kind == "fragment" and t.rigid]
    found: dict[str, Any] = {"fastest": float(max(speeds, default=0.0)), "through": 0}
    if scene.floor is None:
        return found
    lows = {track.name: _lowest(track) for track in bodies}
    through = [name for name, (centre, corner) in lows.items() if centre < 0 or corner < -FLOOR_TOLERANCE]
    found["deepest"] = float(max((-corner for _, corner in lows.values()), default=0.0))
    if through:
        name = min(through, key=lambda name: lows[name][1])
        centre, corner = lows[name]
        found["detail"] = f"{name}: centre of mass at {centre:.3f} m, lowest corner at {corner:.3f} m"
        found["through"] = len(through)
    return found


def _lowest(track: Track) -> tuple[float, float]:
    """Lowest height of the centre of mass, and of any corner [m]."""
    assert track.rigid is not None
    # Each row maps a point of the mesh to its height in the world.
    down = np.stack([rotation_matrix(quat)[2] for quat in track.quats_wxyz])
    height = track.positions[:, 2]
    corners = np.unique(np.concatenate(track.rigid.hulls), axis=0) if track.rigid.hulls else track.mesh.vertices
    return float((down @ track.rigid.centre + height).min()), float(((down @ corners.T).min(axis=1) + height).min())
