"""Tables of docs/explanation/body_replacement.md: momentum, energy, hulls and time when fragments replace a body.

A ball hits a spinning shape in empty space. Momentum is that of the shape and the ball before the contact, and
of the fragments and the ball once they are put in. The jump of a fragment is the kinetic energy that it gains
from the overlap of hulls alone: the same fragments are put in at rest, with nothing else, and the engine steps.
It is given as a share of the kinetic energy that the fragment has at the swap.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from harness import DATA, MISSES, ROOT, SPEEDS, row_of_axes, save_figure, shape_named, start, table, write_text

from deepfracture.breakers import BreakerOptions, make_breaker
from deepfracture.fracture import material
from deepfracture.geometry import MassProperties
from deepfracture.geometry.convex.hulls import Hulls, fragment_hulls
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.learn import embedded_model
from deepfracture.types import BadInput, ContactMaterial, Floats, Fragments, Grid, Material, Shape
from deepfracture.world import ENGINES, Scene, first_impact, single_ball_scene
from deepfracture.world.collisions import CollisionEvent
from deepfracture.world.engine import BodyState
from deepfracture.world.engines import open_engine
from deepfracture.world.physics_world import PhysicsWorld

SHAPES = ("pot", "bunny", "base", "mug", "squirrel")
LEAST = 12
"""Fragments that a collision has to leave to be measured."""
SPIN = (0.5, -0.3, 0.8)
"""Of the shape before the blow [rad/s]: then angular momentum has a size to compare with."""
STEP = 1 / 240
"""Of the engine while fragments lie still [s]."""
RUNS = 7
FINE = 960
"""Steps a second of the plotted scene."""
BEFORE, AFTER = 10, 30
"""Of those steps that are drawn."""
Moving = list[tuple[MassProperties, BodyState]]


@dataclass(frozen=True, eq=False)
class Break:
    """A collision and what it leaves."""

    shape: Shape
    scene: Scene
    breaker: str
    fragments: Fragments


def body_replacement(
    shapes: tuple[str, ...] = SHAPES,
    resolution: int = 64,
    data: Path = DATA,
    out: Path = ROOT / "runs" / "swap",
    picture: Path = ROOT / "docs" / "images" / "swap.png",
    model: Path | None = None,
) -> Path:
    """Measure the swap on every engine; writes swap.md and the picture of the first shape's.

    Args:
        shapes: names of built-in shapes, or of .obj files in `data`.
        resolution: of the patterns.
        data: folder with real meshes.
        out: folder for the tables.
        picture: file for the plot.
        model: for shapes without a shipped model.
    """
    made_of = material("plaster")
    engines = [engine for engine in ENGINES if engine != "bullet" or find_spec("pybullet")]
    found = [shape for shape in (shape_named(name, data) for name in shapes) if shape is not None]
    if not found:
        raise BadInput(f"shapes: none of {', '.join(shapes)} is there")
    breaks = [one for shape in found for one in breaks_of(shape, made_of, Grid(resolution), model)]
    text = "# The swap\n\n" + hulls_table(breaks) + "\n" + motion_table(breaks, made_of, engines)
    write_text(out / "swap.md", text)
    plot(breaks[0], made_of, engines, picture)
    return out / "swap.md"


def breaks_of(shape: Shape, made_of: Material, grid: Grid, model: Path | None) -> list[Break]:
    """One collision for each breaker, the first of many that leaves enough fragments."""
    found = []
    has = embedded_model(shape.name)
    for name in ("learned", "voronoi") if has or model else ("voronoi",):
        own = None if has or name != "learned" else model
        breaker = make_breaker(name, shape, made_of, BreakerOptions(model=own, resolution=grid.resolution))
        rng = np.random.default_rng(3)
        for _ in range(MISSES):
            scene = single_ball_scene(shape.name, shape, rng, material=made_of.name, speed=(2 * SPEEDS[0], SPEEDS[1]))
            impact = first_impact(scene, shape, materials={made_of.name: made_of})
            fragments = impact and breaker(shape, impact, rng)
            if fragments and len(fragments) >= LEAST:
                spinning = replace(scene.shapes[0], angular_velocity=SPIN)
                found.append(Break(shape, replace(scene, shapes=(spinning,)), name, fragments))
                break
        else:
            raise BadInput(f"{shape.name}: {MISSES} balls in a row leave fewer than {LEAST} fragments")
    return found


def hulls_table(breaks: list[Break]) -> str:
    """Hulls, their volumes, and how long it takes to put them in."""
    rows = []
    for one in breaks:
        hulls = fragment_hulls([piece.mesh for piece in one.fragments])
        excess = np.array([hull.excess for hull in hulls])
        share = 50 / len(hulls)
        own = best(lambda one=one: fragment_hulls([piece.mesh for piece in one.fragments]))
        add = best(lambda one=one, hulls=hulls: at_rest("rapier", one.fragments, hulls, []))
        faces = sum(len(piece.mesh.faces) for piece in one.fragments)
        rows.append(
            [
                one.shape.name, one.breaker, len(hulls), faces, sum(len(hull.points) for hull in hulls),
                f"{100 * excess.min():+.0f} to {100 * excess.max():+.0f} %", int((np.abs(excess) > 0.15).sum()),
                f"{1e3 * own:.1f}", f"{1e3 * add:.1f}", f"{1e3 * share * (own + add):.1f}",
            ]
        )  # fmt: skip
    heads = [
        "shape", "breaker", "fragments", "faces", "hulls", "volume error", "beyond 15 %", "hulls [CPU ms]",
        "adding [CPU ms]", "50 fragments [CPU ms]",
    ]  # fmt: skip
    return table(heads, rows)


def motion_table(breaks: list[Break], made_of: Material, engines: list[str]) -> str:
    """Momentum over the swap, and the jump from overlap alone, by engine."""
    rows = []
    for one in breaks:
        hulls = fragment_hulls([piece.mesh for piece in one.fragments])
        for engine in engines:
            hit, begin, swapped = swapped_motions(one, made_of, engine)
            (p, about, _), (q, then, _) = momentum(begin), momentum(swapped)
            has = energies(one.fragments, moving_whole(hit, one.fragments, one.scene.impulse_fraction))
            gains = [gain / has for gain in at_rest(engine, one.fragments, hulls, [1, 10, 60])]
            rows.append(
                [
                    one.shape.name, one.breaker, engine, f"{100 * np.linalg.norm(q - p) / np.linalg.norm(p):.4f} %",
                    f"{100 * np.linalg.norm(then - about) / np.linalg.norm(about):.4f} %",
                    *(f"{100 * gain.max():.4f} %" for gain in gains),
                ]
            )  # fmt: skip
    heads = [
        "shape", "breaker", "engine", "momentum", "angular momentum", "worst jump, 1 step", "10 steps", "60 steps",
    ]  # fmt: skip
    return table(heads, rows)


def swapped_motions(one: Break, made_of: Material, engine: str) -> tuple[CollisionEvent, Moving, Moving]:
    """The hit, what moves before the contact, and what moves after the swap."""
    world = PhysicsWorld(replace(one.scene, engine=engine), [one.shape], {made_of.name: made_of})
    try:
        hit = next(hit for _ in range(1000) for hit in world.step())
        begin = [(hit.body.mass, hit.before), *((s.body.mass, s.before) for s in hit.strikers)]
        world.replace(hit, one.fragments)
        return hit, begin, [(body.mass, motion) for body, motion in world.moving()]
    finally:
        world.close()


def at_rest(engine: str, fragments: Fragments, hulls: list[Hulls], steps: list[int]) -> list[Floats]:
    """Kinetic energy of each fragment [J] so many steps after all were put in at rest, nothing else being there."""
    still = BodyState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    world = open_engine(engine, gravity=0.0, contact=ContactMaterial(0.5, 0.2))
    try:
        bodies = [
            world.add_body(hull.points, MassProperties(piece.mass, piece.centre, piece.inertia), still)
            for piece, hull in zip(fragments, hulls, strict=True)
        ]
        found = []
        for step in range(1, max(steps, default=0) + 1):
            world.step(STEP)
            if step in steps:
                found.append(energies(fragments, [world.state(body) for body in bodies]))
        return found
    finally:
        world.close()


def moving_whole(hit: CollisionEvent, fragments: Fragments, push: float) -> list[BodyState]:
    """The motion of each fragment at the swap."""
    velocity = hit.before.velocity + push * (hit.after.velocity - hit.before.velocity)
    spin = hit.before.angular_velocity + push * (hit.after.angular_velocity - hit.before.angular_velocity)
    turn = rotation_matrix(hit.before.quat_wxyz)
    return [
        BodyState(
            hit.before.position, hit.before.quat_wxyz,
            velocity + np.cross(spin, turn @ (piece.centre - hit.body.mass.centre)), spin,
        )
        for piece in fragments
    ]  # fmt: skip


def energies(fragments: Fragments, motions: list[BodyState]) -> Floats:
    """Kinetic energy of each fragment [J]."""
    masses = [MassProperties(piece.mass, piece.centre, piece.inertia) for piece in fragments]
    return np.array([momentum([pair])[2] for pair in zip(masses, motions, strict=True)])


def momentum(moving: Moving) -> tuple[Floats, Floats, float]:
    """Linear and angular momentum about the origin [N s, N m s], kinetic energy [J]."""
    linear, angular, energy = np.zeros(3), np.zeros(3), 0.0
    for mass, motion in moving:
        turn = rotation_matrix(motion.quat_wxyz)
        about = turn @ mass.inertia @ turn.T @ motion.angular_velocity
        linear += mass.mass * motion.velocity
        angular += mass.mass * np.cross(motion.position + turn @ mass.centre, motion.velocity) + about
        energy += 0.5 * float(mass.mass * motion.velocity @ motion.velocity + about @ motion.angular_velocity)
    return linear, angular, energy


def best(job: Callable[[], object]) -> float:
    """Processor time of the cheapest of several runs, all threads together [s]: it is the same on a busy machine."""
    spent = []
    for _ in range(RUNS):
        began = time.process_time()
        job()
        spent.append(time.process_time() - began)
    return min(spent)


def around(one: Break, made_of: Material, engine: str) -> Floats:
    """Rows (time from the swap [s], energy, momentum (3), angular momentum (3)) around the break, shape (n, 8)."""
    fine = replace(one.scene, engine=engine, steps_per_second=FINE)
    world = PhysicsWorld(fine, [one.shape], {made_of.name: made_of})
    rows: list[Floats] = []
    swapped = None
    try:
        while swapped is None or len(rows) < swapped + AFTER:
            for hit in world.step():
                if swapped is None:
                    swapped = len(rows)
                    world.replace(hit, one.fragments)
            linear, angular, energy = momentum([(body.mass, motion) for body, motion in world.moving()])
            rows.append(np.array([world.time, energy, *linear, *angular]))
    finally:
        world.close()
    found = np.array(rows[max(swapped - BEFORE, 0) :])
    found[:, 0] -= rows[swapped][0]
    return found


def plot(one: Break, made_of: Material, engines: list[str], path: Path) -> None:
    """Energy, momentum and angular momentum against time around the swap."""
    figure, axes = row_of_axes(3, (11, 3.4))
    for engine in engines:
        rows = around(one, made_of, engine)
        first = rows[0]
        drifts = (np.linalg.norm(rows[:, k : k + 3] - first[k : k + 3], axis=1) for k in (2, 5))
        sizes = (np.linalg.norm(first[k : k + 3]) for k in (2, 5))
        lines = (rows[:, 1] / first[1], *(100 * drift / size for drift, size in zip(drifts, sizes, strict=True)))
        for axis, line in zip(axes, lines, strict=True):
            axis.plot(1e3 * rows[:, 0], line, marker=".", markersize=4, label=engine)
    for axis, what in zip(
        axes,
        ("kinetic energy [of that before]", "change of momentum [%]", "change of angular momentum [%]"),
        strict=True,
    ):
        axis.axvline(0, color="0.6", linewidth=0.8)
        axis.set(xlabel="time from the swap [ms]", ylabel=what)
    axes[0].set_ylim(0, 1.05)
    axes[1].set_ylim(-0.05, 1.05)
    axes[1].axhline(1, color="0.6", linewidth=0.8, linestyle=":")
    axes[2].axhline(1, color="0.6", linewidth=0.8, linestyle=":")
    axes[0].legend()
    figure.suptitle(f"{one.shape.name}: {len(one.fragments)} fragments ({one.breaker}) put in at 0 ms", fontsize=10)
    save_figure(figure, path, 120)


if __name__ == "__main__":
    start(body_replacement)
