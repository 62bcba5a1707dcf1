"""Contact and momentum: Hertz's closed forms, the balance of a load, and what the engines report."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from deepfracture.fracture.contact import contacts, effective_modulus, hertz, tractions
from deepfracture.fracture.elastostatics import prepare, solve
from deepfracture.fracture.materials import material
from deepfracture.geometry import MassProperties, builtin, mass_properties
from deepfracture.types import ContactMaterial, Floats, Impact, Shape
from deepfracture.validation.meshes import icosphere
from deepfracture.validation.report import Curve, Finding, Plot, Report
from deepfracture.world import ENGINES, BodyState
from deepfracture.world.engines import open_engine

RESTITUTION = 0.2


def hertz_motion() -> Report:
    """A ball that strikes: m δ'' = -4/3 E* sqrt(R) δ^(3/2), integrated, against the closed forms of the
    duration and of the greatest compression and force (Johnson 1985, eq. 11.22-11.24)."""
    from scipy.integrate import solve_ivp

    stone, impulse, speed, radius = material("stone"), 50.0, 6.0, 0.08
    stiffness = 4 / 3 * effective_modulus(stone) * radius**0.5
    mass = impulse / speed

    def motion(_: float, state: Floats) -> list[float]:
        return [state[1], -stiffness * max(state[0], 0.0) ** 1.5 / mass]

    def leaves(_: float, state: Floats) -> float:
        return state[0]

    leaves.terminal, leaves.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    contact = hertz(impulse, speed, radius, stone)
    end = 3 * contact.duration
    run = solve_ivp(motion, (0, end), [0, speed], events=leaves, rtol=1e-9, atol=1e-14, max_step=end / 3000)
    force = stiffness * np.maximum(run.y[0], 0) ** 1.5
    peak = stiffness * (contact.radius**2 / radius) ** 1.5
    steps = len(run.t)
    plot = Plot(
        "hertz",
        "A steel ball of 8 cm strikes stone at 6 m/s",
        "time [ms]",
        "force [kN]",
        (
            Curve("equation of motion", 1e3 * run.t, force / 1e3, "-"),
            Curve("peak, closed form", [1e3 * contact.duration / 2], [peak / 1e3], "D"),
            Curve("end, closed form", [1e3 * contact.duration], [0.0], "s"),
        ),
    )
    return Report(
        (
            Finding.relative("Hertz contact time [s]", run.t[-1], contact.duration, limit=1e-3, n=steps),
            Finding.relative("Hertz peak force [N]", force.max(), peak, limit=1e-3, n=steps),
        ),
        (plot,),
    )


def load_balance(frequency: int) -> Report:
    """Two slanted contacts on a sphere: their tractions have the contacts' resultant, and with the inertia of
    the body no force and no torque is left."""
    slant = np.array([[np.sin(0.5), 0, -np.cos(0.5)], [0.0, 1, 0]])
    places = np.array([[0.0, 0, 1], [0.0, -1, 0]])
    impact = Impact(places, slant, np.array([300.0, 120.0]), places, speed=8.0, radius=0.1)
    body, stone = prepare(icosphere(frequency), 0.25), material("stone")
    load = tractions(impact, stone, body.mesh)
    areas, arms = body.panels.areas[:, None], body.panels.centres - body.centre
    resultant = (load * areas).sum(axis=0)
    exact = sum(c.force * d for c, d in zip(contacts(impact, stone), slant, strict=True))
    force = np.linalg.norm(exact)
    left = solve(body, load).traction * areas
    unbalanced = np.linalg.norm(left.sum(axis=0)) / force
    turning = np.linalg.norm(np.cross(arms, left).sum(axis=0)) / force
    n = len(areas)
    missing = np.linalg.norm(resultant - exact) / force
    return Report(
        (
            Finding("load, resultant force [N]", float(force), float(np.linalg.norm(resultant)), missing, 1e-8, n),
            Finding("load and inertia, force left / load", 0.0, float(unbalanced), float(unbalanced), 1e-8, n),
            Finding("load and inertia, torque left / load", 0.0, float(turning), float(turning), 1e-8, n),
        )
    )


def installed_engines() -> tuple[str, ...]:
    """The engines that are installed: Bullet has no wheels for every Python."""
    return tuple(engine for engine in ENGINES if engine != "bullet" or find_spec("pybullet"))


def engine_momentum(speed: float) -> Report:
    """A ball squarely on a free bar, in each engine, for restitution e: it loses and the bar gains
    (1 + e) v / (1 / m + 1 / M); the impulses that the engine reports add up to what the bar gains."""
    shape, density, ball = builtin("bar"), material("stone").density, 100.0
    mass = mass_properties(shape.mesh, density)
    exact = (1 + RESTITUTION) * speed / (1 / ball + 1 / mass.mass)
    findings = []
    for engine in installed_engines():
        reported, gained, lost = _square_hit(engine, shape, mass, ball, speed)
        steps = round(0.6 / speed / _step(speed))
        findings += [
            Finding.relative(f"momentum gained, {engine} [N s]", exact, gained, limit=0.02, n=steps),
            Finding.relative(f"momentum lost by the ball, {engine} [N s]", gained, lost, limit=0.02, n=steps),
            Finding.relative(f"impulses reported, {engine} [N s]", gained, reported, limit=0.02, n=steps),
        ]
    return Report(tuple(findings))


def _step(speed: float) -> float:
    """Time step [s] in which the ball moves an eighth of its radius at most, as in a scene."""
    return min(1 / 240, 0.025 / speed)


def _square_hit(
    engine: str, shape: Shape, mass: MassProperties, ball_mass: float, speed: float
) -> tuple[float, float, float]:
    """Impulse reported, momentum gained by the bar, momentum lost by the ball [N s]."""
    rest, upright = np.zeros(3), np.array([1.0, 0, 0, 0])
    world = open_engine(engine, gravity=0.0, contact=ContactMaterial(0.5, RESTITUTION))
    bar = world.add_body([shape.mesh.vertices], mass, BodyState(rest, upright, rest, rest))
    ball = world.add_ball(0.2, ball_mass, BodyState(np.array([0, -0.45, 0]), upright, np.array([0, speed, 0.0]), rest))
    reported, step = 0.0, _step(speed)
    for _ in range(round(0.6 / speed / step)):
        began = world.state(bar)
        world.step(step)
        reported += sum(c.impulse for c in world.contacts(bar, began) if c.other == ball)
    gained = mass.mass * float(world.state(bar).velocity[1])
    lost = ball_mass * (speed - float(world.state(ball).velocity[1]))
    world.close()
    return reported, gained, lost
