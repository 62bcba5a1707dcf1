"""Whole fractures: what beam theory and fracture mechanics say about where and when a body breaks.

Each is repeated over seeds, which draw the material's variation in space; the loads are the least that break
the body, found by raising them step by step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from deepfracture.fracture import FractureBody, critical_stress, material, prepare_body, simulate
from deepfracture.fracture.contact import contacts
from deepfracture.geometry.solids import extruded_quads
from deepfracture.types import Floats, FracturePattern, Grid, Impact, Mesh, Shape
from deepfracture.validation.meshes import box
from deepfracture.validation.report import Curve, Finding, Plot, Report

MATERIAL = "plaster"
SPEED, RADIUS = 3.0, 0.2
"""Of the loading ball: they set the duration of the contact [m/s, m]."""
LENGTH, DEPTH = 2.0, 0.3
"""Of the bars, whose section is square [m]."""
SPAN = 0.85
"""Distance of each support from the middle [m]."""
STOUT, SHEAR = 0.6, 0.1
"""Depth of the bar that is sheared and distance of each line of load from its middle [m]: the tension between the
lines is then 1.7 times the greatest that the inertia of the ends brings outside them."""
NOTCH = (-0.3, -0.1)
"""Root of the notch in the plate: x, z [m]."""
HARD = 30.0
"""Force of the blows that compare toughnesses, in those at which the criterion is met."""
RAISE = 1.2
"""Step by which a load is raised until the body breaks."""

Loads = Callable[[float], Impact]
"""From the impulse of the strongest contact [N s] to the impact."""


def crack_faces(pattern: FracturePattern) -> tuple[Floats, Floats]:
    """Centres (k, 3) [m] and axes (k,) of the voxel faces between two fragments."""
    centres, axes = [], []
    for axis in range(3):
        labels = np.moveaxis(pattern.labels, axis, 0)
        parted = (labels[:-1] != labels[1:]) & (labels[:-1] > 0) & (labels[1:] > 0)
        index = np.argwhere(parted) + np.array([0.5, 0, 0])
        # Back from (axis, the other two in order) to (x, y, z).
        centres.append(pattern.grid.to_world(np.insert(index[:, 1:], axis, index[:, 0], axis=1)))
        axes.append(np.full(len(index), axis))
    return np.concatenate(centres), np.concatenate(axes)


def contact_impact(places: Floats, directions: Floats, impulses: Floats) -> Impact:
    """An impact of contacts at `places` (k, 3) along `directions` (k, 3), each against the surface."""
    return Impact(places, directions, impulses, -np.asarray(directions), speed=SPEED, radius=RADIUS)


def onset_patterns(body: FractureBody, loads: Loads, seeds: int) -> list[FracturePattern]:
    """For each seed the pattern under the least load that breaks the body, to a step of `RAISE`."""
    impulse = 1.0
    while _broken(body, loads(impulse), 0) is None:
        impulse *= 2
    patterns = []
    for seed in range(seeds):
        broken = _broken(body, loads(impulse), seed)
        lower = broken
        while lower is not None:
            broken, impulse = lower, impulse / RAISE
            lower = _broken(body, loads(impulse), seed)
        while broken is None:
            impulse *= RAISE
            broken = _broken(body, loads(impulse), seed)
        patterns.append(broken)
    return patterns


def _broken(body: FractureBody, impact: Impact, seed: int) -> FracturePattern | None:
    result = simulate(body, impact, np.random.default_rng(seed))
    return None if result is None else result.pattern


def _body(name: str, mesh: Mesh, resolution: int) -> FractureBody:
    return prepare_body(Shape(name, mesh), material(MATERIAL), Grid(resolution))


def _bar(resolution: int, depth: float = DEPTH) -> FractureBody:
    cells = round(20 * depth)
    return _body("bar", box((LENGTH, depth, depth), (40, cells, cells)), resolution)


def bending_loads(low: float, high: float) -> Loads:
    """Three-point bending in z: I on top of the middle, I / 2 from below at each support."""
    places = np.array([[0.0, 0, high], [SPAN, 0, low], [-SPAN, 0, low]])
    directions = np.array([[0.0, 0, -1], [0, 0, 1], [0, 0, 1]])
    return lambda impulse: contact_impact(places, directions, np.array([impulse, impulse / 2, impulse / 2]))


def _break_at(pattern: FracturePattern, depth: float) -> float:
    """Median x of where cracks part the core of the bar, the middle half of its `depth`, lengthwise [m]."""
    centres, axes = crack_faces(pattern)
    core = (axes == 0) & (np.abs(centres[:, 1:]).max(axis=1) < depth / 4)
    return float(np.median(centres[core, 0])) if core.any() else float("nan")


def _cut_at(pattern: FracturePattern, depth: float) -> float:
    """The same for the cracks nearest to the middle on each line along the bar: further ones may cut it again."""
    centres, axes = crack_faces(pattern)
    core = centres[(axes == 0) & (np.abs(centres[:, 1:]).max(axis=1) < depth / 4)]
    core = core[np.abs(core[:, 0]).argsort(kind="stable")]
    nearest = np.unique(core[:, 1:].round(9), axis=0, return_index=True)[1]
    return float(np.median(core[nearest, 0])) if len(core) else float("nan")


def three_point_bend(resolution: int, seeds: int) -> Report:
    """The bending moment is greatest in the middle: a bar breaks within a tenth of its length from there."""
    body = _bar(resolution)
    loads = bending_loads(-DEPTH / 2, DEPTH / 2)
    at = np.array([_break_at(pattern, DEPTH) for pattern in onset_patterns(body, loads, seeds)])
    share = np.abs(at) / LENGTH
    worst = int(share.argmax())
    x = np.array([-1, -SPAN, 0, SPAN, 1])
    plot = Plot(
        "three-point-bend",
        f"Three-point bending, {seeds} bars, {resolution} voxels",
        "place along the bar [m]",
        "moment / greatest, bar number / bars",
        (
            Curve("bending moment", x, [0, 0, 1, 0, 0], "-"),
            Curve("break of each bar", at, (np.arange(seeds) + 0.5) / seeds, "o"),
        ),
    )
    finding = Finding(
        "three-point bend, break from the middle / length", 0.0, share[worst], share[worst], 0.1, resolution
    )
    return Report((finding,), (plot,))


def near_shear(resolution: int, seeds: int) -> Report:
    """Two opposite impulses on lines a little apart cut a free bar between the two lines."""
    body = _bar(resolution, STOUT)
    places = np.array([[-SHEAR, 0, STOUT / 2], [SHEAR, 0, -STOUT / 2]])
    directions = np.array([[0.0, 0, -1], [0, 0, 1]])

    def loads(impulse: float) -> Impact:
        return contact_impact(places, directions, np.array([impulse, impulse]))

    at = np.array([_cut_at(pattern, STOUT) for pattern in onset_patterns(body, loads, seeds)])
    share = np.abs(at) / SHEAR
    worst = int(share.argmax())
    plot = Plot(
        "near-shear",
        f"Two opposite impulses, {seeds} bars, {resolution} voxels",
        "place along the bar [m]",
        "bar number / bars",
        (
            Curve("cut of each bar", at, (np.arange(seeds) + 0.5) / seeds, "o"),
            Curve("line of the downward impulse", [-SHEAR, -SHEAR], [0, 1], "--"),
            Curve("line of the upward impulse", [SHEAR, SHEAR], [0, 1], "--"),
        ),
    )
    case = "near shear, cut from the middle / distance of the lines"
    return Report((Finding(case, 0.0, share[worst], share[worst], 1.0, resolution),), (plot,))


def notched_mesh() -> Mesh:
    """A plate of 2 x 0.2 x 0.8 m with a notch of `NOTCH` in its lower edge; x is long, z is up."""
    (x, root), half, length = NOTCH, 0.4, 0.05
    left, right, width = round((x + 1) / length), round((1 - x) / length), 0.05
    low, high = round((root + half) / length), round((half - root) / length)
    quads = (
        ([(-1, -half), (x - width, -half), (x, root), (-1, root)], left, low),
        ([(x + width, -half), (1, -half), (1, root), (x, root)], right, low),
        ([(-1, root), (x, root), (x, half), (-1, half)], left, high),
        ([(x, root), (1, root), (1, half), (x, half)], right, high),
    )
    return extruded_quads(quads, 0.2, 4)


def notched_plate(resolution: int, seeds: int) -> Report:
    """A plate bent in its plane, notched off the middle, breaks from the notch although the moment is greatest
    in the middle."""
    body = _body("notched plate", notched_mesh(), resolution)
    loads = bending_loads(-0.4, 0.4)
    spacing = body.grid.spacing
    root = np.array(NOTCH)
    gaps, paths = [], []
    for pattern in onset_patterns(body, loads, seeds):
        centres, _ = crack_faces(pattern)
        plane = centres[:, [0, 2]]
        gaps.append(float(np.linalg.norm(plane - root, axis=1).min()) / spacing)
        paths.append(plane)
    worst = max(gaps)
    outline, cracks = notched_outline(), np.concatenate(paths)
    plot = Plot(
        "notched-plate",
        f"Notched plate bent in its plane, {seeds} plates, {resolution} voxels",
        "x [m]",
        "z [m]",
        (
            Curve("cracks", cracks[:, 0], cracks[:, 1], "."),
            Curve("plate", outline[:, 0], outline[:, 1], "-"),
        ),
    )
    case = "notched plate, crack from the root of the notch [voxels]"
    return Report((Finding(case, 0.0, worst, worst, 2.0, resolution),), (plot,))


def notched_outline() -> Floats:
    """The plate seen along y, a closed line (8, 2)."""
    x, root = NOTCH
    return np.array(
        [(-1, -0.4), (x - 0.05, -0.4), (x, root), (x + 0.05, -0.4), (1, -0.4), (1, 0.4), (-1, 0.4), (-1, -0.4)]
    )


def below_strength(resolution: int, seeds: int) -> Report:
    """Nothing breaks below the paper's criterion, nor in bending where the beam's greatest stress is half the
    strength (its scatter of 16 % leaves no place so weak)."""
    body = _bar(resolution)
    bend = bending_loads(-DEPTH / 2, DEPTH / 2)
    gate = 1.0
    while critical_stress(bend(gate), body.material, body.area) < 0.99 * body.material.strength:
        gate *= 1.005
    while critical_stress(bend(gate), body.material, body.area) > body.material.strength:
        gate /= 1.005
    half = 1.0
    while _beam_stress(bend(half), body) < 0.5 * body.material.strength:
        half *= 1.05
    findings = []
    for case, impulse in (("below the criterion", gate), ("bent to half the strength", half / 1.05)):
        broken = sum(simulate(body, bend(impulse), np.random.default_rng(seed)) is not None for seed in range(seeds))
        findings.append(Finding(f"{case}, bars broken", 0.0, broken, broken, 0.0, resolution))
    return Report(tuple(findings))


def _beam_stress(impact: Impact, body: FractureBody) -> float:
    """Greatest stress of three-point bending [Pa]: M c / I with M = F SPAN / 2."""
    force = contacts(impact, body.material)[0].force
    return force * SPAN / 2 * (DEPTH / 2) / (DEPTH**4 / 12)


def tougher(resolution: int, seeds: int) -> Report:
    """With the toughness doubled the cracked area does not grow, in the mean over seeds."""
    means, areas = [], []
    base = _bar(resolution)
    for factor in (1.0, 2.0):
        body = replace(base, material=replace(base.material, toughness=factor * base.material.toughness))
        results = [_broken(body, _hit(body, HARD), seed) for seed in range(seeds)]
        area = [len(crack_faces(p)[1]) * body.grid.spacing**2 if p else 0.0 for p in results]
        areas.append(area)
        means.append(float(np.mean(area)))
    growth = means[1] / means[0] - 1
    plot = Plot(
        "toughness",
        f"Cracked area with the toughness doubled, {resolution} voxels",
        "cracked area [m^2]",
        "cracked area with twice the toughness [m^2]",
        (Curve("the same hit", areas[0], areas[1], "o"), Curve("equal", [0, max(areas[0])], [0, max(areas[0])], "-")),
    )
    case = "toughness doubled, mean cracked area [m^2]"
    return Report((Finding(case, means[0], means[1], max(0.0, growth), 0.0, resolution),), (plot,))


def _hit(body: FractureBody, factor: float) -> Impact:
    """A blow on top of the bar, `factor` times the force at which the criterion is met."""
    place, down = np.array([[0.1, 0, DEPTH / 2]]), np.array([[0.0, 0, -1]])
    one = critical_stress(contact_impact(place, down, np.ones(1)), body.material, body.area)
    # Force goes as I^(3/5): m = I / v and t ~ m^(2/5).
    return contact_impact(place, down, np.array([(factor * body.material.strength / one) ** (5 / 3)]))
