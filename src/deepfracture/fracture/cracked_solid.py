"""How cracks change the stress of a loaded body: finite elements on the coarse grid, disconnected along cracks.

The boundary elements give the stress of the uncracked body. A crack removes the traction on its faces; the answer
of the cracked body to that removal, added to the uncracked state, is the state of the cracked body (Bueckner 1958).
It is computed with cubic elements, the cells of the coarse grid, which share nodes unless a crack separates them:

    M ü + K u = f,   f: minus the uncracked traction on both faces of every crack, times the load factor,

by implicit Euler steps (backward differences of ü with a lumped mass M): each solves

    (M / Δt^2 + K) u' = f + M / Δt^2 (u + Δt v),   v' = (u' - u) / Δt

by preconditioned conjugate gradients, matrix-free. Release waves leave a crack at their own speed, a severed piece
moves off by its inertia instead of making the system singular, and a piece that hangs by a ligament loads the
ligament. Faces pressed together carry pressure (frictionless penalty contact along the crack's normal; the set of
closed faces is corrected a few times a step, an active-set iteration).

Elements are trilinear with Wilson's incompatible modes, which bend without locking (Taylor, Beresford & Wilson 1976).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry.disjoint_sets import find, union
from deepfracture.types import BadInput, Floats, Ints, NoSolution

Indices = NDArray[np.int32]

TOLERANCE = 0.01
"""Residual of a step relative to the largest load; the uncracked stress is no more accurate."""
MAX_ITERATIONS = 2000
"""Some sixty are typical."""
CONTACT_ITERATIONS = 2
"""Corrections of the set of closed faces in a step."""
CONTACT_TOLERANCE = 0.02
"""Fraction of the faces that may remain on the wrong side until the next step."""
CONTACT_STIFFNESS = 4.0
"""Penalty stiffness of closed faces over Young's modulus divided by the cell's side."""


def elasticity(poisson: float) -> Floats:
    """Hooke's law for a Young's modulus of one, shape (6, 6): xx, yy, zz, yz, xz, xy, shear strains doubled."""
    law = np.zeros((6, 6))
    law[:3, :3] = poisson / ((1 + poisson) * (1 - 2 * poisson))
    law[np.arange(3), np.arange(3)] += 1 / (1 + poisson)
    law[np.arange(3, 6), np.arange(3, 6)] = 0.5 / (1 + poisson)
    return law


def _strain_matrix(gradients: Floats) -> Floats:
    """Strain-displacement matrix (6, 3 k) of k functions with these gradients (k, 3), components innermost."""
    strain = np.zeros((6, 3 * len(gradients)))
    for k, (x, y, z) in enumerate(gradients):
        strain[:, 3 * k : 3 * k + 3] = [[x, 0, 0], [0, y, 0], [0, 0, z], [0, z, y], [z, 0, x], [y, x, 0]]
    return strain


CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""Corners of an element, in the order of its degrees of freedom, shape (8, 3)."""


def _corner_gradients(point: Floats) -> Floats:
    """Gradients of the trilinear shape functions of a unit cube at `point` of [0, 1]^3, shape (8, 3)."""
    value = np.where(CORNERS == 1, point, 1 - np.asarray(point))
    slope = 2.0 * CORNERS - 1
    return np.stack([slope[:, a] * value[:, (a + 1) % 3] * value[:, (a + 2) % 3] for a in range(3)], axis=1)


@cache
def cube_stiffness(poisson: float) -> Floats:
    """Stiffness of a cube of side one and Young's modulus one, shape (24, 24); scales with modulus and side."""
    law = elasticity(poisson)
    full = np.zeros((33, 33))
    for point in 0.5 + (CORNERS - 0.5) / np.sqrt(3):
        bending = np.diag(-4 * (2 * point - 1))  # of 1 - ξ^2, ξ = 2 x - 1, and so on
        strain = np.concatenate([_strain_matrix(_corner_gradients(point)), _strain_matrix(bending)], axis=1)
        full += strain.T @ law @ strain / 8
    # Static condensation of the nine incompatible modes.
    corners, inner = full[:24, :24], full[24:, 24:]
    stiffness = corners - full[:24, 24:] @ np.linalg.solve(inner, full[24:, :24])
    return (stiffness + stiffness.T) / 2


@cache
def _modal_stiffness(poisson: float) -> Floats:
    """`cube_stiffness` in the basis of sums and differences over opposite corners (Hadamard), shape (8, 3, 3).

    A cube is its own mirror image in three planes, so modes of unlike symmetry do not mix: component i of mode
    p = c ^ (4 >> i) belongs to class c, and 576 numbers become eight blocks of nine."""
    pair = np.array([[1, 1], [1, -1]])
    modes = np.kron(np.kron(np.kron(pair, pair), pair), np.eye(3))
    full = modes @ cube_stiffness(poisson) @ modes / 64
    own = np.array([[3 * (c ^ (4 >> i)) + i for i in range(3)] for c in range(8)])
    return np.ascontiguousarray(full[own[:, :, None], own[:, None, :]])


@njit(cache=True)
def _number_nodes(index, is_open, cells):
    """Node at each corner of each cell, shape (n, 8): cells share it if a chain of closed faces connects them."""
    nx, ny, nz = index.shape
    connectivity = np.full((len(cells), 8), -1, np.int32)
    around = np.empty(8, np.int32)
    parent = np.empty(8, np.int32)
    node_of = np.empty(8, np.int32)
    nodes = 0
    for q in range(len(cells)):
        for k in range(8):
            if connectivity[q, k] >= 0:
                continue
            x, y, z = cells[q, 0] + (k >> 2), cells[q, 1] + ((k >> 1) & 1), cells[q, 2] + (k & 1)
            for s in range(8):
                a, b, c = x - 1 + (s >> 2), y - 1 + ((s >> 1) & 1), z - 1 + (s & 1)
                inside = 0 <= a < nx and 0 <= b < ny and 0 <= c < nz
                around[s] = index[a, b, c] if inside else -1
                parent[s] = s
                node_of[s] = -1
            for s in range(8):
                for axis in range(3):
                    step = 4 >> axis
                    if s & step or around[s] < 0 or around[s + step] < 0 or is_open[around[s], axis]:
                        continue
                    union(parent, s, s + step)
            for s in range(8):
                if around[s] < 0:
                    continue
                root = find(parent, s)
                if node_of[root] < 0:
                    node_of[root] = nodes
                    nodes += 1
                connectivity[around[s], 7 - s] = node_of[root]
    return connectivity, nodes


@njit(cache=True)
def _hadamard(a, b, c, d, e, f, g, h):
    """Hadamard transform of the values at the corners: sums and differences along each axis."""
    a, b, c, d, e, f, g, h = a + b, a - b, c + d, c - d, e + f, e - f, g + h, g - h
    a, b, c, d, e, f, g, h = a + c, b + d, a - c, b - d, e + g, f + h, e - g, f - h
    return a + e, b + f, c + g, d + h, a - e, b - f, c - g, d - h


@njit(cache=True)
def _block_multiply(block, x, y, z):
    return (
        block[0, 0] * x + block[0, 1] * y + block[0, 2] * z,
        block[1, 0] * x + block[1, 1] * y + block[1, 2] * z,
        block[2, 0] * x + block[2, 1] * y + block[2, 2] * z,
    )


@njit(cache=True)
def _gather(u, i, nodes):
    """Component i of u at the eight nodes of a cell."""
    return (
        u[nodes[0], i], u[nodes[1], i], u[nodes[2], i], u[nodes[3], i],
        u[nodes[4], i], u[nodes[5], i], u[nodes[6], i], u[nodes[7], i],
    )  # fmt: skip


@njit(cache=True)
def _scatter(out, i, nodes, scale, values):
    for k in range(8):
        out[nodes[k], i] += scale * values[k]


@njit(cache=True)
def _add_stiffness(connectivity, blocks, scale, u, out):
    """Add K u, u of shape (n, 3), to out. Written out, so that it stays in registers."""
    for nodes in connectivity:
        x0, x1, x2, x3, x4, x5, x6, x7 = _hadamard(*_gather(u, 0, nodes))
        y0, y1, y2, y3, y4, y5, y6, y7 = _hadamard(*_gather(u, 1, nodes))
        z0, z1, z2, z3, z4, z5, z6, z7 = _hadamard(*_gather(u, 2, nodes))
        x4, y2, z1 = _block_multiply(blocks[0], x4, y2, z1)
        x5, y3, z0 = _block_multiply(blocks[1], x5, y3, z0)
        x6, y0, z3 = _block_multiply(blocks[2], x6, y0, z3)
        x7, y1, z2 = _block_multiply(blocks[3], x7, y1, z2)
        x0, y6, z5 = _block_multiply(blocks[4], x0, y6, z5)
        x1, y7, z4 = _block_multiply(blocks[5], x1, y7, z4)
        x2, y4, z7 = _block_multiply(blocks[6], x2, y4, z7)
        x3, y5, z6 = _block_multiply(blocks[7], x3, y5, z6)
        _scatter(out, 0, nodes, scale, _hadamard(x0, x1, x2, x3, x4, x5, x6, x7))
        _scatter(out, 1, nodes, scale, _hadamard(y0, y1, y2, y3, y4, y5, y6, y7))
        _scatter(out, 2, nodes, scale, _hadamard(z0, z1, z2, z3, z4, z5, z6, z7))


@njit(cache=True)
def _normal_gap(connectivity, face, normal, u):
    """Mean gap between the two sides of a face (cell, cell beyond, axis) along its normal."""
    low, high, axis = face
    step = 4 >> axis
    gap = 0.0
    for k in range(8):
        if k & step:
            a, b = connectivity[low, k], connectivity[high, k - step]
            for i in range(3):
                gap += 0.25 * (u[b, i] - u[a, i]) * normal[i]
    return gap


@njit(cache=True)
def _add_nodal_force(connectivity, face, force, out):
    """Add `force` to the nodes on the lower side of a face and its opposite to those on the upper side."""
    low, high, axis = face
    step = 4 >> axis
    for k in range(8):
        if k & step:
            a, b = connectivity[low, k], connectivity[high, k - step]
            for i in range(3):
                out[a, i] += 0.25 * force[i]
                out[b, i] -= 0.25 * force[i]


@njit(cache=True)
def _add_penalty_contact(connectivity, faces, normals, closed, stiffness, u, out):
    """Add the penalty forces of closed faces to out."""
    for q in range(len(faces)):
        if closed[q]:
            gap = _normal_gap(connectivity, faces[q], normals[q], u)
            _add_nodal_force(connectivity, faces[q], -stiffness * gap * normals[q], out)


@njit(cache=True)
def _closed(connectivity, faces, normals, u):
    closed = np.zeros(len(faces), np.bool_)
    for q in range(len(faces)):
        closed[q] = _normal_gap(connectivity, faces[q], normals[q], u) < 0
    return closed


@njit(cache=True)
def _add_crack_load(connectivity, faces, tractions, area, out):
    """Add the nodal forces that cancel `tractions` (on the lower side, n outward) on both sides of the faces."""
    for q in range(len(faces)):
        _add_nodal_force(connectivity, faces[q], -area * tractions[q], out)


class _System(NamedTuple):
    """The matrix of one implicit step, M / Δt^2 + K + penalty contact, as its parts."""

    connectivity: Indices
    """Shape (n, 8)."""
    blocks: Floats
    """`_modal_stiffness`, shape (8, 3, 3)."""
    scale: float
    """Young's modulus times the side of a cell [N/m]."""
    mass: Floats
    """M / Δt^2 [N/m], shape (nodes, 1)."""
    faces: Ints
    normals: Floats
    closed: NDArray[np.bool_]
    """Which open faces are pressed together, shape (f,)."""
    penalty: float
    """[N/m]"""


@njit(cache=True)
def _apply(system, u, out):
    """out = (mass + stiffness + penalty contact) u."""
    out[:] = system.mass * u
    _add_stiffness(system.connectivity, system.blocks, system.scale, u, out)
    _add_penalty_contact(system.connectivity, system.faces, system.normals, system.closed, system.penalty, u, out)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _dot(a, b):
    total = 0.0
    for q in range(a.size):
        total += a.flat[q] * b.flat[q]
    return total


@njit(cache=True, fastmath={"reassoc", "contract"})
def _update(x, residual, direction, Ap, inverse, alpha):
    """Step by `alpha` along the direction. Returns the new product of residual and preconditioned residual."""
    product = 0.0
    for q in range(len(x)):
        x[q] += alpha * direction[q]
        residual[q] -= alpha * Ap[q]
        product += residual[q] * inverse[q] * residual[q]
    return product


@njit(cache=True)
def _conjugate_gradients(system, diagonal, right, x, tolerance, max_iterations):
    """Solve for x (n, 3), in place from its initial value, until the norm of the residual is at most `tolerance`,
    with Jacobi preconditioning by `diagonal` (n, 1) (Hestenes & Stiefel 1952). Returns the iterations."""
    Ap = np.empty_like(x)
    _apply(system, x, Ap)
    residual = right - Ap
    inverse = np.ones_like(x) / diagonal
    direction = inverse * residual
    product = _dot(residual, direction)
    for iteration in range(max_iterations):
        if _dot(residual, residual) <= tolerance * tolerance:
            return iteration
        _apply(system, direction, Ap)
        alpha, previous = product / _dot(direction, Ap), product
        product = _update(x.ravel(), residual.ravel(), direction.ravel(), Ap.ravel(), inverse.ravel(), alpha)
        direction = inverse * residual + product / previous * direction
    return max_iterations


@dataclass(eq=False)
class CrackedSolid:
    """The displacement due to cracks. Starts uncracked and at rest; `open_faces`, then `advance`."""

    cells: Ints
    """Index of each cell on its grid, shape (n, 3)."""
    spacing: float
    """Side of a cell [m]."""
    young: float
    poisson: float
    density: float
    index: Indices
    """Number of each cell of the grid, -1 outside the solid, shape (nx, ny, nz)."""
    is_open: NDArray[np.uint8]
    """Whether the face towards the next cell along each axis is open, shape (n, 3)."""
    connectivity: Indices
    """Node at each corner of each cell, shape (n, 8)."""
    displacement: Floats
    """[m], shape (nodes, 3)."""
    velocity: Floats
    """[m/s], shape (nodes, 3)."""
    faces: Ints = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    """Open faces: cell, cell beyond, axis, shape (f, 3)."""
    normals: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    """Crack normal at each open face, towards the cell beyond, shape (f, 3)."""
    max_load: float = 0.0
    """Largest norm of the load of any step so far [N]: the scale of the tolerance, also while the load fades."""
    new_faces: int = 0
    """How many of the faces, the last ones, opened after the last step."""
    contact: bool = True
    """Whether faces pressed together carry pressure."""
    iterations: int = 0
    """Conjugate-gradient iterations so far."""

    @staticmethod
    def on(
        inside: NDArray[np.bool_], *, spacing: float, young: float, poisson: float, density: float, contact: bool = True
    ) -> CrackedSolid:
        """An uncracked solid of the cells where `inside` (nx, ny, nz) is true."""
        if not inside.any():
            raise BadInput("inside must contain at least one cell")
        cells = np.argwhere(inside)
        index = np.full(inside.shape, -1, np.int32)
        index[inside] = np.arange(len(cells))
        is_open = np.zeros((len(cells), 3), np.uint8)
        connectivity, nodes = _number_nodes(index, is_open, cells)
        at_rest = np.zeros((nodes, 3))
        return CrackedSolid(
            cells,
            spacing,
            young,
            poisson,
            density,
            index,
            is_open,
            connectivity,
            at_rest,
            at_rest.copy(),
            contact=contact,
        )

    @property
    def openings(self) -> Floats:
        """Crack opening displacement: relative displacement of the two sides of each open face [m], shape (f, 3)."""
        return self._mean(self.faces[:, 1], self.faces[:, 2], 0) - self._mean(self.faces[:, 0], self.faces[:, 2], 1)

    def open_faces(self, faces: Ints, normals: Floats) -> None:
        """Open faces (cell, cell beyond, axis), shape (k, 3), with the crack's unit `normals` (k, 3) towards beyond."""
        new = self.is_open[faces[:, 0], faces[:, 2]] == 0
        if not new.any():
            return
        faces, normals = faces[new], normals[new]
        self.is_open[faces[:, 0], faces[:, 2]] = 1
        old, before = self.connectivity, (self.displacement, self.velocity)
        self.connectivity, nodes = _number_nodes(self.index, self.is_open, self.cells)
        self.displacement, self.velocity = (self._renumbered(old, value, nodes) for value in before)
        self.faces = np.concatenate([self.faces, faces])
        self.normals = np.concatenate([self.normals, normals])
        self.new_faces += len(faces)

    def advance(self, stress: Floats, step: float) -> None:
        """One implicit Euler step of `step` seconds (inf: to rest) under the uncracked `stress` (n, 6) [Pa].

        Raises NoSolution when the step does not converge."""
        if not len(self.faces):
            return
        load = np.zeros_like(self.displacement)
        _add_crack_load(self.connectivity, self.faces, self._tractions(stress), self.spacing**2, load)
        self.max_load = max(self.max_load, float(np.linalg.norm(load)))
        mass = self._masses()[:, None] / step**2
        guess = self.displacement + (self.velocity * step if np.isfinite(step) else 0.0)
        right = load + mass * guess
        solution = guess.copy()
        closed = self._closed(solution)
        if self.new_faces and self.contact:  # they have no gap yet: the stress that they carried decides
            closed[-self.new_faces :] = self._normal_stress(stress + self.stress())[-self.new_faces :] < 0
        self.new_faces = 0
        for _ in range(CONTACT_ITERATIONS):
            solution = self._solve(right, mass, closed, solution)
            corrected = self._closed(solution)
            if (corrected != closed).mean() <= CONTACT_TOLERANCE:
                break
            closed = corrected
        if np.isfinite(step):
            self.velocity = (solution - self.displacement) / step
        self.displacement = solution

    def stress(self) -> Floats:
        """Stress due to the cracks at the cells' centres [Pa], shape (n, 6): xx, yy, zz, yz, xz, xy."""
        centre = _strain_matrix(_corner_gradients(np.full(3, 0.5)))
        law = self.young / self.spacing * elasticity(self.poisson) @ centre
        return self.displacement[self.connectivity].reshape(-1, 24) @ law.T

    def _solve(self, right: Floats, mass: Floats, closed: NDArray[np.bool_], start: Floats) -> Floats:
        """The displacement (nodes, 3) that balances `right` with `mass` (nodes, 1) [N/m] and these faces closed."""
        blocks, scale = _modal_stiffness(self.poisson), self.young * self.spacing
        cells_at_node = np.bincount(self.connectivity.ravel(), minlength=len(start))[:, None]
        diagonal = mass + scale * cells_at_node * np.trace(blocks.sum(axis=0)) / 3
        solution = start.copy()
        system = _System(
            self.connectivity, blocks, scale, mass, self.faces, self.normals, closed, CONTACT_STIFFNESS * scale
        )
        tolerance = TOLERANCE * self.max_load
        iterations = _conjugate_gradients(system, diagonal, right, solution, tolerance, MAX_ITERATIONS)
        if iterations == MAX_ITERATIONS:
            raise NoSolution(f"the stress of the cracked body did not converge in {MAX_ITERATIONS} iterations")
        self.iterations += iterations
        return solution

    def _closed(self, displacement: Floats) -> NDArray[np.bool_]:
        """Which open faces are pressed together."""
        if not self.contact:
            return np.zeros(len(self.faces), bool)
        return _closed(self.connectivity, self.faces, self.normals, displacement)

    def _normal_stress(self, stress: Floats) -> Floats:
        """Stress normal to the crack at each open face, positive in tension [Pa], shape (f,)."""
        mean = 0.5 * (stress[self.faces[:, 0]] + stress[self.faces[:, 1]])
        x, y, z = self.normals.T
        return np.einsum("fq,qf->f", mean, np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y]))

    def _tractions(self, stress: Floats) -> Floats:
        """Uncracked traction on the lower side of each open face [Pa], shape (f, 3)."""
        mean = 0.5 * (stress[self.faces[:, 0]] + stress[self.faces[:, 1]])
        rows = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
        return np.take_along_axis(mean, rows[self.faces[:, 2]], axis=1)

    def _masses(self) -> Floats:
        """Lumped masses of the nodes [kg], shape (nodes,)."""
        eighth = self.density * self.spacing**3 / 8
        return eighth * np.bincount(self.connectivity.ravel(), minlength=len(self.displacement)).astype(float)

    def _renumbered(self, old: Indices, values: Floats, nodes: int) -> Floats:
        """Nodal `values` of the connectivity `old` on the new nodes."""
        new = np.zeros((nodes, 3))
        new[self.connectivity.ravel()] = values[old.ravel()]
        return new

    def _mean(self, cells: Ints, axes: Ints, side: int) -> Floats:
        """Mean displacement of the corners of `cells` on one side along `axes`, shape (f, 3)."""
        on_side = CORNERS.T[axes] == side  # (f, 8)
        return np.einsum("fk,fki->fi", on_side / 4, self.displacement[self.connectivity[cells]])
