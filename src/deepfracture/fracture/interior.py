"""Stress inside and on the surface of a loaded body, from its boundary solution.

The displacement gradient at x follows from the tangential gradient of u on the surface, integrated by
parts so that no integral is stronger than 1 / r^2 (Bonnet 1999, sec. 4.2; Stokes' theorem):

    ∂_l u_k(x) = ∫ (n_l Σ_ijk ∂_j u_i - n_j Σ_ijk ∂_l u_i) dA - ∫ ∂_l U_ki t_i dA,

with Σ_ijk the stress ij of Kelvin's solution for a unit force along k. Triangles far from x count as
points, in float32 and vectorised; near ones are integrated in closed form.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from deepfracture.fracture.elastostatics import Solution, inertia_stress
from deepfracture.fracture.integrals import kernel, parallel_kernel, triangle_integrals
from deepfracture.types import BadInput, Floats

FAR = 2.5
"""Distance from a triangle's centre, in its diameters, beyond which it counts as a point: 0.1 % of the
stress; nearer ones are integrated exactly."""


def stress_at(solution: Solution, points: ArrayLike, *, far: float = FAR) -> Floats:
    """Stress at points inside the body [Pa], shape (n, 6): xx, yy, zz, yz, xz, xy.

    `points` (n, 3) in the body frame. Close to the surface the closed-form integrals stay exact for the
    discrete solution, which jumps between triangles: nearer than about 0.3 of a triangle the result shows
    those jumps. Outside the body values are finite but mean nothing. `far = inf` integrates every triangle
    in closed form.
    """
    points = np.ascontiguousarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise BadInput(f"points must have shape (n, 3), got {points.shape}")
    body = solution.body
    gradients = np.ascontiguousarray(solution.gradients)
    # Scaled to one, so that float32 neither overflows nor loses anything.
    scale = max(np.abs(gradients).max(), np.abs(solution.traction).max(), np.finfo(float).tiny)
    gradients /= scale
    tractions = solution.traction / scale
    sources = _sources(solution, gradients, tractions, far)
    strain = np.zeros((len(points), 6))
    if np.isfinite(far):
        _far_strain(points.astype(np.float32), sources, body.poisson, strain)
    _near_strain(points, sources, body.panels, gradients, tractions, body.poisson, strain)
    strain *= scale
    offsets = points - body.centre
    inertial = inertia_stress(offsets, solution.acceleration, solution.spin, body.poisson)
    return _hooke(strain, body.poisson) + _voigt(inertial)


def surface_stress(solution: Solution) -> Floats:
    """Stress at the centres of the surface triangles [Pa], shape (nt, 6): xx, yy, zz, yz, xz, xy.

    Plane strains from the tangential displacement gradient, the rest from the traction.
    """
    body = solution.body
    normal = body.panels.normals
    strain = solution.gradients
    strain = (strain + strain.swapaxes(1, 2)) / 2
    plane = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    strain = plane @ strain @ plane
    ratio = body.poisson / (1 - body.poisson)
    pressure = np.einsum("ni,ni->n", solution.traction, normal)
    trace = np.trace(strain, axis1=1, axis2=2)
    # 2 μ = 1 / (1 + ν) for E = 1; the strain along n follows from the traction along n.
    stress = strain / (1 + body.poisson)
    stress += (ratio * (trace / (1 + body.poisson) + pressure))[:, None, None] * plane
    outer = solution.traction[:, :, None] * normal[:, None, :]
    stress += outer + outer.swapaxes(1, 2)
    stress -= pressure[:, None, None] * normal[:, :, None] * normal[:, None, :]
    offsets = body.panels.centres - body.centre
    return _voigt(stress + inertia_stress(offsets, solution.acceleration, solution.spin, body.poisson))


def _voigt(matrices: Floats) -> Floats:
    """Symmetric matrices (n, 3, 3) as (n, 6)."""
    return matrices[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]


def _hooke(strain: Floats, poisson: float) -> Floats:
    """Stress of strains (n, 6) (shear components not doubled) for a Young's modulus of one."""
    stress = strain / (1 + poisson)
    stress[:, :3] += poisson / ((1 + poisson) * (1 - 2 * poisson)) * strain[:, :3].sum(axis=1)[:, None]
    return stress


def _sources(solution: Solution, gradients: Floats, tractions: Floats, far: float) -> np.ndarray:
    """The triangles as float32 points, shape (20, nt): centre, normal, gradient, traction (the last two
    times area), squared distance beyond which the point may stand for the triangle, trace."""
    panels = solution.body.panels
    areas = panels.areas[:, None]
    limit = (2 * far * panels.radii) ** 2
    trace = np.trace(gradients, axis1=1, axis2=2) * panels.areas
    columns = np.column_stack(
        [
            panels.centres,
            panels.normals,
            gradients.reshape(-1, 9) * areas,
            tractions * areas,
            np.minimum(limit, np.finfo(np.float32).max),
            trace,
        ]
    )
    return np.ascontiguousarray(columns.T, dtype=np.float32)


# Both kernels take e_kl = sym(n_l a_k) - sym(b_kl) - sym(∂_l U_ki t_i) with a_k = Σ_ijk ∂_j u_i and
# b_kl = n_j Σ_ijk ∂_l u_i, and 1 / (8π (1 - ν)) as the factor of Kelvin's stress. For a point it collects
# into sym(n p) + sym(r v) + a multiple of sym(∂u) + a multiple of the unit matrix.


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _point_strain(
    r0, r1, r2, n0, n1, n2, g00, g01, g02, g10, g11, g12, g20, g21, g22, t0, t1, t2, limit, trace, poisson
):
    """Strain (xx, yy, zz, yz, xz, xy) at distance r of a point source; zero inside its limit."""
    one, half, three, zero = np.float32(1), np.float32(0.5), np.float32(3), np.float32(0)
    scale = one / (np.float32(8 * np.pi) * (one - poisson))
    square = r0 * r0 + r1 * r1 + r2 * r2
    cubed = one / (square * np.sqrt(square)) if square > limit else zero
    over = three / max(square, np.float32(1e-30))
    w, h = scale * cubed, scale * cubed * (one + poisson)
    b = w * (one - poisson - poisson)
    # r.g and g.r, g the displacement gradient
    rg0, rg1, rg2 = (
        r0 * g00 + r1 * g10 + r2 * g20,
        r0 * g01 + r1 * g11 + r2 * g21,
        r0 * g02 + r1 * g12 + r2 * g22,
    )
    gr0, gr1, gr2 = (
        g00 * r0 + g01 * r1 + g02 * r2,
        g10 * r0 + g11 * r1 + g12 * r2,
        g20 * r0 + g21 * r1 + g22 * r2,
    )
    slant = n0 * r0 + n1 * r1 + n2 * r2
    pull = h * (t0 * r0 + t1 * r1 + t2 * r2)
    q = w * (rg0 * r0 + rg1 * r1 + rg2 * r2) * over - b * trace
    p0, p1, p2 = -b * gr0 - q * r0, -b * gr1 - q * r1, -b * gr2 - q * r2
    a, c, d = w * over * slant, h * (three - np.float32(4) * poisson - one), pull * over
    v0 = a * rg0 - b * (n0 * g00 + n1 * g10 + n2 * g20) + c * t0 + d * r0
    v1 = a * rg1 - b * (n0 * g01 + n1 * g11 + n2 * g21) + c * t1 + d * r1
    v2 = a * rg2 - b * (n0 * g02 + n1 * g12 + n2 * g22) + c * t2 + d * r2
    f = b * slant
    return (
        n0 * p0 + r0 * v0 + f * g00 - pull,
        n1 * p1 + r1 * v1 + f * g11 - pull,
        n2 * p2 + r2 * v2 + f * g22 - pull,
        half * (n1 * p2 + n2 * p1 + r1 * v2 + r2 * v1 + f * (g12 + g21)),
        half * (n0 * p2 + n2 * p0 + r0 * v2 + r2 * v0 + f * (g02 + g20)),
        half * (n0 * p1 + n1 * p0 + r0 * v1 + r1 * v0 + f * (g01 + g10)),
    )


@njit(cache=True, fastmath=True, error_model="numpy", parallel=True)
def _far_strain(points, sources, poisson, strain):
    """Add the strain (n, 6) that distant triangles cause: float32, and rows of sources, to vectorise."""
    c0, c1, c2, n0, n1, n2 = sources[0], sources[1], sources[2], sources[3], sources[4], sources[5]
    g00, g01, g02, g10, g11, g12 = sources[6], sources[7], sources[8], sources[9], sources[10], sources[11]
    g20, g21, g22, t0, t1, t2 = sources[12], sources[13], sources[14], sources[15], sources[16], sources[17]
    limit, trace = sources[18], sources[19]
    ratio = np.float32(poisson)
    for point in prange(len(points)):
        x0, x1, x2 = points[point, 0], points[point, 1], points[point, 2]
        xx = yy = zz = yz = xz = xy = np.float32(0)
        for s in range(sources.shape[1]):
            e = _point_strain(
                c0[s] - x0, c1[s] - x1, c2[s] - x2, n0[s], n1[s], n2[s],
                g00[s], g01[s], g02[s], g10[s], g11[s], g12[s], g20[s], g21[s], g22[s],
                t0[s], t1[s], t2[s], limit[s], trace[s], ratio,
            )  # fmt: skip
            xx += e[0]
            yy += e[1]
            zz += e[2]
            yz += e[3]
            xz += e[4]
            xy += e[5]
        strain[point, 0] += xx
        strain[point, 1] += yy
        strain[point, 2] += zz
        strain[point, 3] += yz
        strain[point, 4] += xz
        strain[point, 5] += xy


@parallel_kernel
def _near_strain(points, sources, panels, gradients, tractions, poisson, strain):
    """Add the strain (n, 6) that near triangles cause, in closed form."""
    c0, c1, c2, limit = sources[0], sources[1], sources[2], sources[18]
    for point in prange(len(points)):
        # The very float32 comparison of the far kernel: each triangle counts exactly once.
        x0, x1, x2 = np.float32(points[point, 0]), np.float32(points[point, 1]), np.float32(points[point, 2])
        r, lengths = np.empty((3, 3)), np.empty(3)
        flux, spread, normal = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
        edge, total = np.empty((3, 3, 3)), np.zeros((3, 3))
        for s in range(len(limit)):
            r0, r1, r2 = c0[s] - x0, c1[s] - x1, c2[s] - x2
            if r0 * r0 + r1 * r1 + r2 * r2 > limit[s]:
                continue
            _, omega, _ = triangle_integrals(
                points[point, 0], points[point, 1], points[point, 2],
                panels, s, False, r, lengths, flux, spread, normal, edge,
            )  # fmt: skip
            _add_gradient(panels, s, gradients[s], tractions[s], poisson, omega, flux, normal, edge, total)
        strain[point, 0] += total[0, 0]
        strain[point, 1] += total[1, 1]
        strain[point, 2] += total[2, 2]
        strain[point, 3] += (total[1, 2] + total[2, 1]) / 2
        strain[point, 4] += (total[0, 2] + total[2, 0]) / 2
        strain[point, 5] += (total[0, 1] + total[1, 0]) / 2


@kernel
def _add_gradient(panels, s, g, t, poisson, omega, flux, normal, edge, total):
    """Add the displacement gradient caused by triangle s with surface gradient g and traction t."""
    shear, diagonal = 1 - 2 * poisson, 3 - 4 * poisson
    scale_t = 1 / (8 * np.pi * (1 - poisson))
    scale_u = (1 + poisson) * scale_t
    n, outward = panels.normals[s], panels.outward[s]
    trace = g[0, 0] + g[1, 1] + g[2, 2]
    pull = t[0] * flux[0] + t[1] * flux[1] + t[2] * flux[2]
    push = t[0] * n[0] + t[1] * n[1] + t[2] * n[2]
    for k in range(3):
        # a_k, with 3 ∫ r_i r_j r_k / r^5 ∂_j u_i from flux and edges.
        a = 2 * poisson * trace * flux[k]
        for j in range(3):
            a += (shear * (g[k, j] + g[j, k]) + g[j, k]) * flux[j]
        for e in range(3):
            v = outward[e]
            for i in range(3):
                a -= edge[e, k, i] * (g[i, 0] * v[0] + g[i, 1] * v[1] + g[i, 2] * v[2])
        for m in range(3):
            b = shear * omega * g[k, m]
            for i in range(3):
                b += (shear * (n[k] * flux[i] - n[i] * flux[k]) + normal[k, i]) * g[i, m]
            # 3 ∫ (t.r) r_k r_m / r^5: normal part, tangential part.
            cubic = push * normal[k, m]
            cubic += (t[k] - push * n[k]) * flux[m] + (t[m] - push * n[m]) * flux[k]
            for e in range(3):
                v = outward[e]
                cubic -= edge[e, k, m] * (t[0] * v[0] + t[1] * v[1] + t[2] * v[2])
            layer = t[m] * flux[k] - diagonal * t[k] * flux[m] - cubic
            if k == m:
                layer += pull
            total[k, m] += scale_t * (b - n[m] * a) - scale_u * layer
