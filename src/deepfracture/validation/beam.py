"""A cantilever: the exact end tractions of Saint-Venant's flexure, so that no end effect blurs the answer.

Rectangle 2a x 2b (a along the load x, b along y), length L along z, force P along x at z = L
(Timoshenko & Goodier 1970, art. 120-124):

    σ_z = -P (L - z) x / I,    τ_xz = ∂φ/∂y + P (a^2 - x^2) / (2 I),    τ_yz = -∂φ/∂x,
    ∇^2 φ = ν / (1 + ν) P y / I  inside,  φ = 0  on the edge.
"""

from __future__ import annotations

import numpy as np

from deepfracture.fracture.elastostatics import prepare, solve
from deepfracture.fracture.interior import surface_stress
from deepfracture.types import Floats
from deepfracture.validation.elastic import POISSON
from deepfracture.validation.meshes import box
from deepfracture.validation.report import Curve, Finding, Plot, Report

LENGTH, DEPTH = 2.0, 0.4
TERMS = 30
"""Of the series of φ; they fall as n^-3 and faster off the edge."""


def shear_stress(x: Floats, y: Floats, poisson: float) -> tuple[Floats, Floats]:
    """τ_xz and τ_yz of a square section of `DEPTH` under P = I (so that both are divided by P / I)."""
    a = b = DEPTH / 2
    c = poisson / (1 + poisson)
    along, across = c * (3 * y**2 - b**2) / 6, np.zeros_like(x)
    for n in range(1, TERMS + 1):
        k = n * np.pi / b
        amount = -2 * c * (-1) ** n / k**3  # makes φ vanish at x = ±a, where the polynomial does not
        # cosh(k x) / cosh(k a) and sinh(k x) / cosh(k a), without overflow
        rise, fall = np.exp(k * (x - a)), np.exp(-k * (x + a))
        scale = 1 + np.exp(-2 * k * a)
        along += amount * k * np.cos(k * y) * (rise + fall) / scale
        across -= amount * k * np.sin(k * y) * (rise - fall) / scale
    return along + (a**2 - x**2) / 2, across


def cantilever(along: int, across: int) -> Report:
    """Tip deflection and root stress of a bar of `along` x `across` x `across` squares.

    The mean deflection of the tip, seen from the mean position and the mean rotation of the root, is exactly
    P L^3 / (3 E I) + P L / (κ G A), κ = 10 (1 + ν) / (12 + 11 ν) (Timoshenko; κ: Cowper 1966)."""
    body = prepare(box((DEPTH, DEPTH, LENGTH), (across, across, along)), POISSON)
    inertia, area = DEPTH**4 / 12, DEPTH**2
    places, normals, areas = body.panels.centres, body.panels.normals, body.panels.areas
    ends = {sign: normals[:, 2] * sign > 0.5 for sign in (1, -1)}
    tractions = np.zeros((len(places), 3))
    for sign, end in ends.items():
        x, y, z = _samples(body.mesh.triangles[end]).transpose(2, 1, 0)  # each (samples, nt)
        lateral = shear_stress(x, y, POISSON)
        bending = -(LENGTH / 2 - z) * x
        tractions[end] = sign * np.stack([*lateral, bending]).mean(axis=1).T / inertia  # P = 1
    solution = solve(body, tractions)
    moved = solution.displacement[body.mesh.faces].mean(axis=1)

    def mean(values: Floats, end: np.ndarray) -> float:
        return float(np.average(values[end], weights=areas[end]))

    root = ends[-1]
    # ∫ x u_z dA / I with x u_z integrated exactly on each triangle would change this by h^2 only.
    rotation = mean(moved[:, 2] * places[:, 0], root) / mean(places[:, 0] ** 2, root)
    # In the root's frame: the section turns about y by -rotation, which lifts the tip by -rotation L.
    deflection = mean(moved[:, 0], ends[1]) - mean(moved[:, 0], root) + rotation * LENGTH
    kappa = 10 * (1 + POISSON) / (12 + 11 * POISSON)
    exact = LENGTH**3 / (3 * inertia) + LENGTH * 2 * (1 + POISSON) / (kappa * area)
    stress = surface_stress(solution)[:, 2]
    sides = np.abs(normals[:, 0]) > 0.5
    from_root = places[:, 2] + LENGTH / 2
    fibre = -np.sign(normals[:, 0]) * stress
    beside = sides & (from_root < LENGTH / 4)
    fit = np.polyfit(from_root[beside], fibre[beside], 1)
    peak = LENGTH * DEPTH / 2 / inertia
    n = len(places)
    plot = Plot(
        "cantilever",
        f"Cantilever under a force at its tip, N = {n}",
        "distance from the root [m]",
        "stress of the outer fibre x I / (P L c)",
        (
            Curve("ours", from_root[sides], fibre[sides] / peak, "."),
            Curve("beam theory, exact here", [0, LENGTH], [1, 0], "-"),
        ),
    )
    return Report(
        (
            Finding.relative("cantilever, tip deflection", exact, deflection, limit=0.05, n=n),
            Finding.relative("cantilever, root stress", peak, float(fit[1]), limit=0.05, n=n),
        ),
        (plot,),
    )


def _samples(triangles: Floats, count: int = 4) -> Floats:
    """Centres of count^2 sub-triangles of each triangle, shape (nt, count^2, 3)."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(count) for j in range(count - i)]
    turned = [(i + 2 / 3, j + 2 / 3) for i in range(count - 1) for j in range(count - 1 - i)]
    first = np.array(upright + turned) / count
    weights = np.column_stack([first, 1 - first.sum(axis=1)])
    return np.einsum("sk,nki->nsi", weights, triangles)
