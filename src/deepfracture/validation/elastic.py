"""The boundary elements against closed forms of elasticity: uniform tension, Lamé, rigid motion, inertia."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepfracture.fracture.elastostatics import ElasticBody, Solution, assemble, prepare, solve
from deepfracture.fracture.interior import stress_at, surface_stress
from deepfracture.types import Floats, Mesh
from deepfracture.validation.meshes import box, concatenated, cylinder, icosphere, inverted, jittered
from deepfracture.validation.report import Curve, Finding, Plot, Report

POISSON = 0.3


def tensors(voigt: Floats) -> Floats:
    """(n, 6) in the order xx, yy, zz, yz, xz, xy -> (n, 3, 3)."""
    return voigt[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]


def points_inside(radius: float, count: int = 150) -> Floats:
    """Points in all directions at distances up to `radius` from the origin, shape (count, 3)."""
    points = np.random.default_rng(2).normal(size=(count, 3))
    return points * radius * np.linspace(0.02, 1, count)[:, None] / np.linalg.norm(points, axis=1)[:, None]


def patch_mesh(name: str, cells: int) -> Mesh:
    """A body for the uniform states: cube, sphere, irregular or plate, `cells` triangles across."""
    if name == "cube":
        return box((1, 1, 1), (cells, cells, cells))
    if name == "sphere":
        return icosphere(cells)
    if name == "irregular":
        return jittered(icosphere(cells), 0.3 / cells, np.random.default_rng(1)).moved(0.7, [3, -2, 1])
    return box((2, 2, 0.2), (2 * cells, 2 * cells, 1))


def _thickness(body: ElasticBody) -> float:
    return float(np.ptp(body.mesh.vertices, axis=0).min())


def uniform_tension(names: Sequence[str], cells: int) -> Report:
    """Tractions n_z e_z: exactly σ_zz = 1 everywhere, u = (-ν x, -ν y, z) / E."""
    exact_stress = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    findings = []
    for name in names:
        body = prepare(patch_mesh(name, cells), POISSON)
        solution = solve(body, body.panels.normals * [0, 0, 1])
        exact = ((body.mesh.vertices - body.centre) * [-POISSON, -POISSON, 1.0]).ravel()
        exact -= body.rigid_modes @ (body.rigid_modes.T @ exact)
        moved = np.abs(solution.displacement.ravel() - exact).max() / np.abs(exact).max()
        inside = body.centre + points_inside(0.35 * _thickness(body))
        stress = np.concatenate([surface_stress(solution), stress_at(solution, inside, far=np.inf)])
        worst = stress[np.abs(stress[:, 2] - 1).argmax(), 2]
        error = max(float(moved), float(np.abs(stress - exact_stress).max()))
        findings.append(Finding(f"uniform tension, {name}", 1.0, float(worst), error, 1e-3, len(body.mesh.faces)))
    return Report(tuple(findings))


def rigid_motion(names: Sequence[str], cells: int) -> Report:
    """A displacement a + ω x r has no traction and no stress."""
    findings = []
    for name in names:
        body = prepare(patch_mesh(name, cells), POISSON)
        double, _ = assemble(body.mesh, body.panels, POISSON)
        translations = np.tile(np.eye(3), (len(body.mesh.vertices), 1))
        pull = np.abs(double @ translations).max() / np.abs(np.diag(double)).mean()
        offsets = body.mesh.vertices - body.centre
        moved = np.array([0.3, -0.2, 0.5]) + np.cross([0.4, 0.1, -0.7], offsets)
        still = Solution(body, np.zeros((len(body.mesh.faces), 3)), moved, np.zeros(3), np.zeros(3))
        inside = body.centre + points_inside(0.3 * _thickness(body), 40)
        stress = max(np.abs(surface_stress(still)).max(), np.abs(stress_at(still, inside, far=np.inf)).max())
        error = max(float(pull), float(stress))
        findings.append(Finding(f"rigid motion, {name}", 0.0, error, error, 1e-8, len(body.mesh.faces)))
    return Report(tuple(findings))


def hollow_sphere(frequencies: Sequence[tuple[int, int]]) -> Report:
    """Radii 0.5 and 1, inner pressure 1 (Lamé; Timoshenko & Goodier 1970, art. 136):

    σ_θ = f (1 + b^3 / 2 r^3), σ_r = f (1 - b^3 / r^3), f = a^3 / (b^3 - a^3).

    `frequencies` of the outer and the inner icosphere, coarse to fine; the finest is held to the limit."""
    factor = 0.5**3 / (1 - 0.5**3)
    sizes, errors = [], []
    radii = measured = np.empty(0)
    for outer, inner in frequencies:
        body = prepare(concatenated(icosphere(outer), inverted(icosphere(inner, 0.5))), POISSON)
        cavity = np.linalg.norm(body.panels.centres, axis=1) < 0.75
        solution = solve(body, np.where(cavity[:, None], -body.panels.normals, 0.0))
        inside = points_inside(1.0, 200)
        inside *= (np.linspace(0.6, 0.9, 200) / np.linalg.norm(inside, axis=1))[:, None]
        stress = np.concatenate([surface_stress(solution), stress_at(solution, inside)])
        # The surface is where its spheres are; a triangle's centre lies a little deeper.
        radii = np.concatenate([np.where(cavity, 0.5, 1.0), np.linalg.norm(inside, axis=1)])
        measured = np.linalg.eigvalsh(tensors(stress))
        hoop, radial = factor * (1 + 0.5 / radii**3), factor * (1 - 1 / radii**3)
        exact = np.column_stack([radial, hoop, hoop])
        weight = np.concatenate([body.panels.areas, np.full(200, body.panels.areas.sum() / 200)])[:, None]
        errors.append(float(np.sqrt((weight * (measured - exact) ** 2).sum() / (weight * exact**2).sum())))
        sizes.append(len(body.mesh.faces))
    order = -2 * float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])  # element size ~ N^-1/2
    r = np.linspace(0.5, 1, 50)
    profile = Plot(
        "hollow-sphere",
        f"Hollow sphere under pressure, N = {sizes[-1]}",
        "radius [m]",
        "principal stress / pressure",
        (
            Curve("hoop, ours", radii, measured[:, 2], "."),
            Curve("radial, ours", radii, measured[:, 0], "."),
            Curve("hoop, Lamé", r, factor * (1 + 0.5 / r**3), "-"),
            Curve("radial, Lamé", r, factor * (1 - 1 / r**3), "-"),
        ),
    )
    slope = errors[-1] * np.sqrt(sizes[-1] / np.array(sizes)) ** order
    convergence = Plot(
        "hollow-sphere-convergence",
        "Hollow sphere: error against elements",
        "triangles",
        "L2 error of the principal stresses",
        (Curve("ours", sizes, errors, "o"), Curve(f"order {order:.1f} in the element size", sizes, slope, "-")),
        log=True,
    )
    peak = float(np.average(measured[radii == 0.5, 2]))
    return Report(
        (
            Finding("hollow sphere, principal stresses (L2)", factor * 5, peak, errors[-1], 0.02, sizes[-1]),
            # Linear displacements: stress converges at least with the element size.
            Finding("hollow sphere, order of convergence", 1.0, order, max(0.0, 1.0 - order), 0.0, sizes[-1]),
        ),
        (profile, convergence),
    )


def pulled_bar(counts: tuple[int, int, int]) -> Report:
    """A free bar pulled at one end by p: its inertia leaves exactly σ_xx = p (1/2 + x / L), all else zero."""
    body = prepare(box((2, 0.5, 0.5), counts), POISSON)
    tractions = np.zeros((len(body.mesh.faces), 3))
    tractions[body.panels.normals[:, 0] > 0.5, 0] = 1.0
    solution = solve(body, tractions)
    points = np.random.default_rng(3).uniform(-1, 1, (200, 3)) * [0.95, 0.2, 0.2]
    places = np.concatenate([points, body.panels.centres])
    stress = np.concatenate([stress_at(solution, points), surface_stress(solution)])
    exact = np.zeros((len(places), 6))
    exact[:, 0] = 0.5 + places[:, 0] / 2
    error = np.abs(stress - exact).max()
    n = len(body.mesh.faces)
    along = np.array([-1.0, 1.0])
    plot = Plot(
        "pulled-bar",
        f"Free bar pulled at x = 1, N = {n}",
        "x [m]",
        "σ_xx / p",
        (Curve("ours", places[:, 0], stress[:, 0], "."), Curve("p (1/2 + x / L)", along, 0.5 + along / 2, "-")),
    )
    middle = float(np.interp(0.5, *_sorted(places[:, 0], stress[:, 0])))
    return Report(
        (
            Finding.relative("pulled free bar, acceleration", 0.5, float(solution.acceleration[0]), limit=0.02, n=n),
            Finding("pulled free bar, stress (worst point)", 0.75, middle, float(error), 0.02, n),
        ),
        (plot,),
    )


def twisted_bar(around: int, along: int) -> Report:
    """A free round bar twisted at one end by t = e_x x r: its inertia leaves exactly the shear stress
    (1/2 + x / L) e_x x r, and it spins up by torque over inertia, ρ α = 1 / L."""
    body = prepare(cylinder(0.5, 2, around, along), POISSON)
    axis = np.array([1.0, 0, 0])
    tractions = np.zeros((len(body.mesh.faces), 3))
    end = body.panels.normals[:, 0] > 0.9
    tractions[end] = np.cross(axis, body.panels.centres[end])
    solution = solve(body, tractions)
    points = np.random.default_rng(3).uniform(-1, 1, (200, 3)) * [0.95, 0.3, 0.3]
    shear = np.cross(axis, points) * (0.5 + points[:, :1] / 2)
    exact = np.zeros((len(points), 6))
    exact[:, 5], exact[:, 4] = shear[:, 1], shear[:, 2]
    stress = stress_at(solution, points)
    n = len(body.mesh.faces)
    size, true = (np.linalg.norm(values[:, 4:], axis=1) for values in (stress, exact))
    error = np.sqrt(((stress - exact) ** 2).sum() / (exact**2).sum())
    plot = Plot(
        "twisted-bar",
        f"Free round bar twisted at x = 1, N = {n}",
        "exact shear stress / greatest traction",
        "ours",
        (Curve("points inside", 2 * true, 2 * size, "."), Curve("exact", [0, 1], [0, 1], "-")),
    )
    return Report(
        (
            Finding.relative("twisted free bar, spin-up", 0.5, float(solution.spin[0]), limit=0.02, n=n),
            Finding("twisted free bar, shear stress (L2)", true.max(), size[true.argmax()], float(error), 0.02, n),
        ),
        (plot,),
    )


def pinched(body: ElasticBody) -> tuple[Solution, Floats]:
    """A sphere under two opposite forces of one on a diameter, each spread over the triangles round a vertex,
    and the diameter's direction (3,)."""
    pole = body.mesh.vertices[0] / np.linalg.norm(body.mesh.vertices[0])
    tractions = np.zeros((len(body.mesh.faces), 3))
    for sign in (1, -1):
        tip = int(np.argmax(sign * body.mesh.vertices @ pole))
        cap = (body.mesh.faces == tip).any(axis=1)
        tractions[cap] = -sign * pole / body.panels.areas[cap].sum()
    return solve(body, tractions), pole


def pinched_sphere(frequency: int) -> Report:
    """Two opposite forces F on a diameter: at the centre, across it, σ = 21 / (28 + 20 ν) F / (π R^2), along it
    σ = -(42 + 15 ν) / (14 + 10 ν) F / (π R^2) (Sternberg & Rosenthal 1952)."""
    solution, pole = pinched(prepare(icosphere(frequency), POISSON))
    at = np.linspace(-0.7, 0.7, 57)
    stress = tensors(stress_at(solution, at[:, None] * pole)) * np.pi
    along = np.einsum("i,nij,j->n", pole, stress, pole)
    across = (np.trace(stress, axis1=1, axis2=2) - along) / 2
    tension, pressure = 21 / (28 + 20 * POISSON), -(42 + 15 * POISSON) / (14 + 10 * POISSON)
    n = len(solution.body.mesh.faces)
    plot = Plot(
        "pinched-sphere",
        f"Sphere pinched by two forces, N = {n}",
        "place on the diameter / R",
        "stress x π R^2 / F",
        (
            Curve("along the diameter, ours", at, along, "."),
            Curve("across, ours", at, across, "."),
            Curve("centre, Sternberg & Rosenthal", [0, 0], [pressure, tension], "D"),
        ),
    )
    middle = len(at) // 2
    return Report(
        (
            Finding.relative("pinched sphere, tension at the centre", tension, across[middle], limit=0.02, n=n),
            Finding.relative("pinched sphere, pressure at the centre", pressure, along[middle], limit=0.02, n=n),
        ),
        (plot,),
    )


def _sorted(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    order = np.argsort(x)
    return x[order], y[order]
