"""Linear elastostatics of a free body by the boundary element method.

Displacements u are linear between vertices, tractions t constant on triangles; the boundary
integral equation is tested against the same linear functions (Galerkin) with three outer points
and closed-form inner integrals. With Kelvin's solution U and its traction T,

    ∫ T(x, y) (u(y) - u(x)) dA = ∫ U(x, y) t(y) dA        (Rizzo 1967; free term by rigid motion)

Everything is computed for a Young's modulus of one: tractions in Pa give stresses in Pa, and the
displacements come out multiplied by the modulus. A body that nothing holds is balanced by its own
inertia (d'Alembert); the density drops out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numba import prange
from numpy.typing import ArrayLike

from deepfracture.fracture.integrals import (
    Panels,
    kernel,
    panels,
    parallel_kernel,
    triangle_integrals,
)
from deepfracture.geometry import mass_properties
from deepfracture.runtime.files import atomic_file
from deepfracture.types import BadInput, Floats, Ints, Labels, Mesh, NoSolution

FAR = 3.0
"""Distance of two triangles, in diameters of the inner one, beyond which three points integrate it:
the uniform-tension test then stays below 1e-4."""
BALANCE_TOL = 1e-8
"""Force and torque that may be left after inertia balances a load, relative to the load."""
CLOSED_TOL = 1e-6
"""Sum of the area vectors of a closed surface, relative to its area: float32 noise of mesh files."""
FORMAT = "deepfracture elastic body 1"


@dataclass(frozen=True, eq=False)
class ElasticBody:
    """A body ready to be loaded: the factorised boundary element system of its surface."""

    mesh: Mesh
    poisson: float
    factor: Floats
    """LU factor of the transposed, regularised double layer, shape (3 nv, 3 nv)."""
    pivots: Labels
    """Row exchanges of the factor, shape (3 nv,)."""
    single_layer: Floats
    """Tractions to the right-hand side, shape (3 nv, 3 nt)."""
    centre: Floats
    """Centre of volume [m], shape (3,)."""

    @cached_property
    def panels(self) -> Panels:
        return panels(self.mesh)

    @cached_property
    def rigid_modes(self) -> Floats:
        """Orthonormal translations and rotations of the vertices, shape (3 nv, 6)."""
        return _rigid_modes(self.mesh.vertices - self.centre)

    def save(self, path: str | Path) -> None:
        """Write to one .npz file, complete or not at all."""
        path = Path(path)
        with atomic_file(path) as temporary, open(temporary, "wb") as file:
            np.savez(
                file,
                format=np.array(FORMAT),
                vertices=self.mesh.vertices,
                faces=self.mesh.faces,
                poisson=np.array(self.poisson),
                factor=self.factor,
                pivots=self.pivots,
                single_layer=self.single_layer,
                centre=self.centre,
            )

    @staticmethod
    def load(path: str | Path) -> ElasticBody:
        """Read what `save` wrote. Raises BadInput for any other file."""
        with open(path, "rb") as raw:
            if raw.read(2) != b"PK":
                raise BadInput(f"{path}: not a saved elastic body; delete it and prepare the body again")
        try:
            with np.load(path, allow_pickle=False) as file:
                if str(file["format"]) != FORMAT:
                    raise ValueError(str(file["format"]))
                return ElasticBody(
                    mesh=Mesh(file["vertices"], file["faces"]),
                    poisson=float(file["poisson"]),
                    factor=file["factor"],
                    pivots=file["pivots"],
                    single_layer=file["single_layer"],
                    centre=file["centre"],
                )
        except Exception as error:  # numpy and zipfile raise errors of many kinds on damaged files
            raise BadInput(f"{path}: not a saved elastic body; delete it and prepare the body again") from error


@dataclass(frozen=True, eq=False)
class Solution:
    """The elastic state of a loaded body: a particular field that carries the inertia, plus a
    complementary field without body force that the boundary elements solve for."""

    body: ElasticBody
    traction: Floats
    """Complementary traction [Pa], shape (nt, 3)."""
    displacement: Floats
    """Complementary displacement times Young's modulus [Pa m], shape (nv, 3)."""
    acceleration: Floats
    """Acceleration of the centre times density [N / m^3], shape (3,)."""
    spin: Floats
    """Angular acceleration times density [N / m^4], shape (3,)."""

    @property
    def gradients(self) -> Floats:
        """Surface gradient du_i / dx_j of the complementary displacement [Pa], shape (nt, 3, 3)."""
        corners = self.displacement[self.body.mesh.faces]
        return np.einsum("tai,taj->tij", corners, self.body.panels.gradients)


def prepare(mesh: Mesh, poisson: float) -> ElasticBody:
    """Assemble and factorise the boundary element system of a closed mesh.

    `mesh` may have several shells (cavities point inwards). Raises BadInput for a surface that is
    open, inside out or has triangles without area.
    """
    from scipy.linalg import lu_factor

    if not -1 < poisson < 0.5:
        raise BadInput(f"poisson must lie in (-1, 0.5), got {poisson}")
    surface = panels(mesh)
    centre = _centre(mesh)
    double, single = assemble(mesh, surface, poisson)
    modes = _rigid_modes(mesh.vertices - centre)
    # Rigid motions are the null space of the double layer: give them its mean diagonal, so that the
    # system is regular and well scaled. `solve` removes them from the result.
    double += (modes * (np.trace(double) / len(double))) @ modes.T
    # LAPACK is column-major: factorising the transpose in place saves a copy.
    factor, pivots = lu_factor(double.T, overwrite_a=True, check_finite=False)
    return ElasticBody(mesh, poisson, factor, pivots.astype(np.int32), single, centre)


def solve(body: ElasticBody, tractions: ArrayLike) -> Solution:
    """The elastic state under `tractions` [Pa], shape (nt, 3), constant on each triangle.

    Whatever force and torque the load has accelerates the free body; the inertia is part of the state.
    Raises NoSolution if the system is singular.
    """
    from scipy.linalg import lu_solve

    tractions = np.asarray(tractions, float)
    if tractions.shape != body.panels.centres.shape:
        raise BadInput(f"tractions must have shape {body.panels.centres.shape}, got {tractions.shape}")
    if not np.isfinite(tractions).all():
        raise BadInput("tractions must be finite, got NaN or infinite values")
    acceleration, spin, inertial = _balance(body, tractions)
    rest = tractions - inertial
    right = body.single_layer @ rest.ravel()
    displacement = lu_solve((body.factor, body.pivots), right, trans=1, check_finite=False)
    displacement -= body.rigid_modes @ (body.rigid_modes.T @ displacement)
    if not np.isfinite(displacement).all():
        raise NoSolution("the elastic system of this mesh is singular: it has triangles that coincide or vanish")
    return Solution(body, rest, displacement.reshape(-1, 3), acceleration, spin)


def inertia_stress(offsets: Floats, acceleration: Floats, spin: Floats, poisson: float) -> Floats:
    """Stress [Pa], shape (n, 3, 3), of a field with div σ = acceleration + spin x offset.

    Derived from u_i = a_i x_i^2 / (2 (λ + 2μ)) and u = |x|^2 (α x x) / (10 μ), with `offsets` (n, 3) from
    the centre; both satisfy Navier's equation exactly.
    """
    ratio = poisson / (1 - poisson)  # λ / (λ + 2μ)
    along = offsets * acceleration
    turning = np.cross(spin, offsets)
    stress = (offsets[:, :, None] * turning[:, None, :] + turning[:, :, None] * offsets[:, None, :]) / 5
    axes = np.arange(3)
    stress[:, axes, axes] += ratio * along.sum(axis=1)[:, None] + (1 - ratio) * along
    return stress


def _balance(body: ElasticBody, tractions: Floats) -> tuple[Floats, Floats, Floats]:
    """Acceleration and spin (per density) whose inertia balances the load on this very mesh, and the
    traction (nt, 3) of the particular field that carries it."""
    arms = body.panels.centres - body.centre
    areas, normals = body.panels.areas[:, None], body.panels.normals

    def resultant(traction: Floats) -> Floats:
        force = traction * areas
        return np.concatenate([force.sum(axis=0), np.cross(arms, force).sum(axis=0)])

    modes = np.stack(
        [np.einsum("nij,nj->ni", inertia_stress(arms, mode[:3], mode[3:], body.poisson), normals) for mode in np.eye(6)]
    )
    load = resultant(tractions)
    amount = np.linalg.solve(np.stack([resultant(mode) for mode in modes], axis=1), load).astype(float)
    inertial = np.asarray(np.einsum("m,mni->ni", amount, modes), float)
    left = np.abs(resultant(tractions - inertial)).max()
    scale = (np.abs(tractions) * areas).sum() * max(1.0, np.abs(arms).max())
    assert left <= BALANCE_TOL * scale, f"unbalanced load {left} of {scale}"
    return amount[:3], amount[3:], inertial


def _centre(mesh: Mesh) -> Floats:
    """Centre of volume of a closed mesh [m], shape (3,). Raises BadInput when it is open or inside out."""
    area = mesh.area_vectors
    if np.abs(area.sum(axis=0)).max() > CLOSED_TOL * np.abs(area).sum():
        raise BadInput("the surface is not closed: its area vectors do not add up to zero; repair the mesh")
    return mass_properties(mesh, 1.0).centre


def _rigid_modes(offsets: Floats) -> Floats:
    """Orthonormal rigid motions of points at `offsets` (n, 3) from the centre, shape (3 n, 6)."""
    modes = np.zeros((len(offsets), 3, 6))
    for axis, unit in enumerate(np.eye(3)):
        modes[:, axis, axis] = 1.0
        modes[:, :, 3 + axis] = np.cross(unit, offsets)
    return np.linalg.qr(modes.reshape(-1, 6))[0]


def assemble(mesh: Mesh, surface: Panels, poisson: float) -> tuple[Floats, Floats]:
    """Double layer (3 nv, 3 nv) and single layer (3 nv, 3 nt), rows divided by the vertex areas."""
    size = 3 * len(mesh.vertices)
    double = np.zeros((size, size))
    single = np.zeros((size, 3 * len(mesh.faces)))
    order, starts = _colours(mesh.faces, len(mesh.vertices))
    faces = np.ascontiguousarray(mesh.faces)
    _assemble(order, starts, faces, surface, poisson, double, single)
    areas = np.bincount(faces.ravel(), np.repeat(surface.areas / 3, 3), minlength=len(mesh.vertices))
    if not areas.all():
        raise BadInput(f"{(areas == 0).sum()} vertices belong to no triangle; remove them")
    rows = np.repeat(1 / areas, 3)[:, None]
    double *= rows
    single *= rows
    return double, single


def _colours(faces: Ints, vertices: int) -> tuple[Ints, Ints]:
    """Triangles sorted by a colour that no two triangles with a common vertex share, and where each
    colour starts: threads can then add to the matrix without a race, in an order that never changes."""
    taken = [0] * vertices
    colours = np.empty(len(faces), np.int64)
    for index, (a, b, c) in enumerate(faces.tolist()):
        free = ~(taken[a] | taken[b] | taken[c])
        lowest = free & -free
        colours[index] = lowest.bit_length() - 1
        taken[a] |= lowest
        taken[b] |= lowest
        taken[c] |= lowest
    order = np.argsort(colours, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(colours))]).astype(np.int64)
    return order, starts


# Three points of degree two, (2/3, 1/6, 1/6) and its turns: a linear function with corner values f_a
# is (f_a + f_b + f_c) / 6 + f_a / 2 at point a, and so is the weight of point a in corner a's test.


@parallel_kernel
def _assemble(order, starts, faces, panels, poisson, double, single):
    for colour in range(len(starts) - 1):
        for position in prange(starts[colour], starts[colour + 1]):
            _add_rows(order[position], faces, panels, poisson, double, single)


@kernel
def _add_rows(outer, faces, panels, poisson, double, single):
    """Add what triangle `outer` contributes as the place of test: three points, all inner triangles."""
    corners = panels.corners[outer]
    points = np.empty((3, 3))
    for q in range(3):
        for i in range(3):
            total = corners[0, i] + corners[1, i] + corners[2, i]
            points[q, i] = total / 6 + corners[q, i] / 2
    weight = panels.areas[outer] / 3
    kernel_t = np.empty((3, 3, 3, 3))  # outer point, inner corner, row, column
    kernel_u = np.empty((3, 3, 3))  # outer point, row, column
    closure = np.zeros((3, 3, 3))  # ∫ T over the whole surface, seen from each outer point
    r, lengths = np.empty((3, 3)), np.empty(3)
    flux, spread, normal = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    edge, constant = np.empty((3, 3, 3)), np.empty((3, 3))
    for inner in range(len(faces)):
        reach = panels.radii[outer] + 2 * FAR * panels.radii[inner]
        gap2 = 0.0
        for i in range(3):
            gap2 += (panels.centres[inner, i] - panels.centres[outer, i]) ** 2
        if gap2 > reach * reach:
            _far_kernels(points, panels, inner, poisson, kernel_u, kernel_t)
        else:
            for q in range(3):
                _near_kernels(
                    points[q], panels, inner, inner == outer, poisson, kernel_u[q], kernel_t[q],
                    r, lengths, flux, spread, normal, edge, constant,
                )  # fmt: skip
        for q in range(3):
            for k in range(3):
                for i in range(3):
                    closure[q, k, i] += kernel_t[q, 0, k, i] + kernel_t[q, 1, k, i] + kernel_t[q, 2, k, i]
        _weigh(weight, kernel_u, kernel_t)
        _scatter(outer, inner, faces, kernel_u, kernel_t, double, single)
    _subtract_rigid(outer, faces, weight, closure, double)


@kernel
def _far_kernels(points, panels, inner, poisson, kernel_u, kernel_t):
    """Kelvin's U and T from the outer points to triangle `inner`, by its own three points."""
    scale_u = (1 + poisson) / (8 * np.pi * (1 - poisson))  # 1 / (16 π μ (1 - ν)) with E = 1
    scale_t = -1 / (8 * np.pi * (1 - poisson))
    diagonal, shear = 3 - 4 * poisson, 1 - 2 * poisson
    corners = panels.corners[inner]
    n0, n1, n2 = panels.normals[inner, 0], panels.normals[inner, 1], panels.normals[inner, 2]
    weight = panels.areas[inner] / 3
    mid0 = (corners[0, 0] + corners[1, 0] + corners[2, 0]) / 6
    mid1 = (corners[0, 1] + corners[1, 1] + corners[2, 1]) / 6
    mid2 = (corners[0, 2] + corners[1, 2] + corners[2, 2]) / 6
    for q in range(3):
        u00 = u01 = u02 = u11 = u12 = u22 = 0.0
        t = kernel_t[q]
        for p in range(3):
            r0 = mid0 + corners[p, 0] / 2 - points[q, 0]
            r1 = mid1 + corners[p, 1] / 2 - points[q, 1]
            r2 = mid2 + corners[p, 2] / 2 - points[q, 2]
            inverse2 = 1.0 / (r0 * r0 + r1 * r1 + r2 * r2)
            inverse = np.sqrt(inverse2)
            cubed = weight * inverse * inverse2
            slant = r0 * n0 + r1 * n1 + r2 * n2
            u = scale_u * cubed
            same = scale_u * diagonal * weight * inverse
            u00 += u * r0 * r0 + same
            u11 += u * r1 * r1 + same
            u22 += u * r2 * r2 + same
            u01 += u * r0 * r1
            u02 += u * r0 * r2
            u12 += u * r1 * r2
            f = scale_t * 3 * cubed * inverse2 * slant
            g = scale_t * shear * cubed
            d01, d02, d12 = g * (n0 * r1 - n1 * r0), g * (n0 * r2 - n2 * r0), g * (n1 * r2 - n2 * r1)
            t[p, 0, 0] = f * r0 * r0 + g * slant
            t[p, 1, 1] = f * r1 * r1 + g * slant
            t[p, 2, 2] = f * r2 * r2 + g * slant
            t[p, 0, 1], t[p, 1, 0] = f * r0 * r1 + d01, f * r0 * r1 - d01
            t[p, 0, 2], t[p, 2, 0] = f * r0 * r2 + d02, f * r0 * r2 - d02
            t[p, 1, 2], t[p, 2, 1] = f * r1 * r2 + d12, f * r1 * r2 - d12
        _fill_symmetric(kernel_u[q], u00, u01, u02, u11, u12, u22)
        for k in range(3):
            for i in range(3):
                third = (t[0, k, i] + t[1, k, i] + t[2, k, i]) / 6
                for p in range(3):
                    t[p, k, i] = third + t[p, k, i] / 2


@kernel
def _fill_symmetric(matrix, m00, m01, m02, m11, m12, m22):
    matrix[0, 0], matrix[1, 1], matrix[2, 2] = m00, m11, m22
    matrix[0, 1] = matrix[1, 0] = m01
    matrix[0, 2] = matrix[2, 0] = m02
    matrix[1, 2] = matrix[2, 1] = m12


@kernel
def _near_kernels(
    point, panels, inner, own, poisson, kernel_u, kernel_t, r, lengths, flux, spread, normal, edge, constant
):
    """∫ U and ∫ T φ_b over triangle `inner` in closed form, φ_b linear with φ_b = 1 at corner b."""
    scale_u = (1 + poisson) / (8 * np.pi * (1 - poisson))
    scale_t = -1 / (8 * np.pi * (1 - poisson))
    diagonal, shear = 3 - 4 * poisson, 1 - 2 * poisson
    n = panels.normals[inner]
    potential, omega, height = triangle_integrals(
        point[0], point[1], point[2], panels, inner, own, r, lengths, flux, spread, normal, edge
    )
    for k in range(3):
        for i in range(3):
            kernel_u[k, i] = scale_u * spread[k, i]
            constant[k, i] = shear * (n[k] * flux[i] - n[i] * flux[k]) + normal[k, i]
        kernel_u[k, k] += scale_u * diagonal * potential
        constant[k, k] += shear * omega
    for corner in range(3):
        g, opposite = panels.gradients[inner, corner], panels.corners[inner, (corner + 1) % 3]
        # φ(y) = φ(foot of x) + g.r, and g is tangential.
        foot = sloped_flux = 0.0
        for i in range(3):
            foot += g[i] * (point[i] - opposite[i])
            sloped_flux += g[i] * flux[i]
        for k in range(3):
            for i in range(3):
                sloped = height * (g[k] * flux[i] + g[i] * flux[k])
                for e in range(3):
                    v = panels.outward[inner, e]
                    slope = g[0] * v[0] + g[1] * v[1] + g[2] * v[2]
                    sloped -= height * slope * edge[e, k, i]
                for j in range(3):
                    sloped += shear * g[j] * (n[k] * spread[i, j] - n[i] * spread[k, j])
                if i == k:
                    sloped += shear * height * sloped_flux
                kernel_t[corner, k, i] = scale_t * (foot * constant[k, i] + sloped)


@kernel
def _weigh(weight, kernel_u, kernel_t):
    """Turn the values at the three outer points into integrals against the three test functions."""
    for k in range(3):
        for i in range(3):
            u0, u1, u2 = weight * kernel_u[0, k, i], weight * kernel_u[1, k, i], weight * kernel_u[2, k, i]
            mean = (u0 + u1 + u2) / 6
            kernel_u[0, k, i], kernel_u[1, k, i], kernel_u[2, k, i] = (
                mean + u0 / 2,
                mean + u1 / 2,
                mean + u2 / 2,
            )
    for b in range(3):
        for k in range(3):
            for i in range(3):
                t0, t1, t2 = kernel_t[0, b, k, i], kernel_t[1, b, k, i], kernel_t[2, b, k, i]
                mean = weight * (t0 + t1 + t2) / 6
                kernel_t[0, b, k, i] = mean + weight * t0 / 2
                kernel_t[1, b, k, i] = mean + weight * t1 / 2
                kernel_t[2, b, k, i] = mean + weight * t2 / 2


@kernel
def _scatter(outer, inner, faces, kernel_u, kernel_t, double, single):
    """Add the integrals of a pair of triangles to the two matrices."""
    for a in range(3):
        for k in range(3):
            row = 3 * faces[outer, a] + k
            for i in range(3):
                single[row, 3 * inner + i] += kernel_u[a, k, i]
            for b in range(3):
                column = 3 * faces[inner, b]
                for i in range(3):
                    double[row, column + i] += kernel_t[a, b, k, i]


@kernel
def _subtract_rigid(outer, faces, weight, closure, double):
    """The free term: -u(x) ∫ T at every outer point, so that a translation has no traction at all."""
    for q in range(3):
        for a in range(3):
            test = 2 / 3 if a == q else 1 / 6
            for b in range(3):
                factor = weight * test * (2 / 3 if b == q else 1 / 6)
                for k in range(3):
                    for i in range(3):
                        row, column = 3 * faces[outer, a] + k, 3 * faces[outer, b] + i
                        double[row, column] -= factor * closure[q, k, i]
