"""What cracks change in a loaded body: finite elements on the coarse lattice, parted where cracks run.

The boundary elements give the stress of the uncracked body. A crack removes the traction on its faces; the answer
of the cracked body to that removal, added to the uncracked state, is the state of the cracked body (Bueckner 1958).
It is computed on cubes, one a cell of the coarse lattice, which share their corners unless a crack parts them:

    M ü + K u = f,   f: minus the uncracked traction on both faces of every crack, scaled with the load,

by implicit Euler steps, so that release waves leave a crack at their own speed, a severed piece flies off by its
inertia instead of making the system singular, and what still hangs by a ligament pulls at the ligament. Faces
that are pressed together carry the pressure (a penalty along the crack's normal, without friction).

Cubes are trilinear with Wilson's incompatible modes, which bend without locking (Taylor, Beresford & Wilson 1976).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepfracture.geometry.disjoint_sets import find, union
from deepfracture.types import BadInput, Floats, Ints, NoSolution

Numbers = NDArray[np.int32]

TOLERANCE = 0.01
"""Residual of a step relative to the largest load: the stresses it is added to are no better known."""
MOST_ITERATIONS = 2000
"""Some sixty are usual."""
CONTACT_ROUNDS = 2
"""Times that the set of pressed faces is corrected in a step."""
SETTLED = 0.02
"""Share of the faces that may still change sides: they do so in the next step."""
CONTACT_STIFFNESS = 4.0
"""Penalty of pressed faces over Young's modulus divided by the cell's side."""


def elasticity(poisson: float) -> Floats:
    """Hooke's law for a Young's modulus of one, shape (6, 6): xx, yy, zz, yz, xz, xy, shear strains doubled."""
    law = np.zeros((6, 6))
    law[:3, :3] = poisson / ((1 + poisson) * (1 - 2 * poisson))
    law[np.arange(3), np.arange(3)] += 1 / (1 + poisson)
    law[np.arange(3, 6), np.arange(3, 6)] = 0.5 / (1 + poisson)
    return law


def _strain_of(gradients: Floats) -> Floats:
    """Strains (6, 3 k) of k functions with these gradients (k, 3), displacement components innermost."""
    strain = np.zeros((6, 3 * len(gradients)))
    for k, (x, y, z) in enumerate(gradients):
        strain[:, 3 * k : 3 * k + 3] = [[x, 0, 0], [0, y, 0], [0, 0, z], [0, z, y], [z, 0, x], [y, x, 0]]
    return strain


CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""Corners of a cell, in the order of its degrees of freedom, shape (8, 3)."""


def _corner_gradients(point: Floats) -> Floats:
    """Gradients of the trilinear functions of a unit cube at `point` of [0, 1]^3, shape (8, 3)."""
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
        strain = np.concatenate([_strain_of(_corner_gradients(point)), _strain_of(bending)], axis=1)
        full += strain.T @ law @ strain / 8
    kept, inner = full[:24, :24], full[24:, 24:]
    stiffness = kept - full[:24, 24:] @ np.linalg.solve(inner, full[24:, :24])
    return (stiffness + stiffness.T) / 2


@cache
def _modal_stiffness(poisson: float) -> Floats:
    """`cube_stiffness` between sums and differences over opposite corners (Hadamard), shape (8, 3, 3).

    A cube is its own mirror image in three planes, so modes of unlike symmetry do not mix: component i of mode
    p = c ^ (4 >> i) belongs to class c, and 576 numbers become eight blocks of nine."""
    pair = np.array([[1, 1], [1, -1]])
    modes = np.kron(np.kron(np.kron(pair, pair), pair), np.eye(3))
    full = modes @ cube_stiffness(poisson) @ modes / 64
    own = np.array([[3 * (c ^ (4 >> i)) + i for i in range(3)] for c in range(8)])
    return np.ascontiguousarray(full[own[:, :, None], own[:, None, :]])


@njit(cache=True)
def _number_corners(index, parted, cells):
    """Node of each corner of each cell, shape (n, 8): cells share a corner if a chain of whole faces joins them."""
    nx, ny, nz = index.shape
    corner = np.full((len(cells), 8), -1, np.int32)
    around = np.empty(8, np.int32)
    parent = np.empty(8, np.int32)
    node_of = np.empty(8, np.int32)
    nodes = 0
    for q in range(len(cells)):
        for k in range(8):
            if corner[q, k] >= 0:
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
                    if s & step or around[s] < 0 or around[s + step] < 0 or parted[around[s], axis]:
                        continue
                    union(parent, s, s + step)
            for s in range(8):
                if around[s] < 0:
                    continue
                root = find(parent, s)
                if node_of[root] < 0:
                    node_of[root] = nodes
                    nodes += 1
                corner[around[s], 7 - s] = node_of[root]
    return corner, nodes


@njit(cache=True)
def _turn(a, b, c, d, e, f, g, h):
    """Sums and differences of what the corners hold, over opposite corners along each axis."""
    a, b, c, d, e, f, g, h = a + b, a - b, c + d, c - d, e + f, e - f, g + h, g - h
    a, b, c, d, e, f, g, h = a + c, b + d, a - c, b - d, e + g, f + h, e - g, f - h
    return a + e, b + f, c + g, d + h, a - e, b - f, c - g, d - h


@njit(cache=True)
def _resist(block, x, y, z):
    return (
        block[0, 0] * x + block[0, 1] * y + block[0, 2] * z,
        block[1, 0] * x + block[1, 1] * y + block[1, 2] * z,
        block[2, 0] * x + block[2, 1] * y + block[2, 2] * z,
    )


@njit(cache=True)
def _gathered(u, i, nodes):
    """Component i of u at the eight corners of a cell."""
    return (
        u[nodes[0], i], u[nodes[1], i], u[nodes[2], i], u[nodes[3], i],
        u[nodes[4], i], u[nodes[5], i], u[nodes[6], i], u[nodes[7], i],
    )  # fmt: skip


@njit(cache=True)
def _scatter(out, i, nodes, scale, values):
    for k in range(8):
        out[nodes[k], i] += scale * values[k]


@njit(cache=True)
def _multiply(corner, blocks, scale, u, out):
    """Add the stiffness of the cells times u (n, 3) to out. Written out, so that it stays in registers."""
    for nodes in corner:
        x0, x1, x2, x3, x4, x5, x6, x7 = _turn(*_gathered(u, 0, nodes))
        y0, y1, y2, y3, y4, y5, y6, y7 = _turn(*_gathered(u, 1, nodes))
        z0, z1, z2, z3, z4, z5, z6, z7 = _turn(*_gathered(u, 2, nodes))
        x4, y2, z1 = _resist(blocks[0], x4, y2, z1)
        x5, y3, z0 = _resist(blocks[1], x5, y3, z0)
        x6, y0, z3 = _resist(blocks[2], x6, y0, z3)
        x7, y1, z2 = _resist(blocks[3], x7, y1, z2)
        x0, y6, z5 = _resist(blocks[4], x0, y6, z5)
        x1, y7, z4 = _resist(blocks[5], x1, y7, z4)
        x2, y4, z7 = _resist(blocks[6], x2, y4, z7)
        x3, y5, z6 = _resist(blocks[7], x3, y5, z6)
        _scatter(out, 0, nodes, scale, _turn(x0, x1, x2, x3, x4, x5, x6, x7))
        _scatter(out, 1, nodes, scale, _turn(y0, y1, y2, y3, y4, y5, y6, y7))
        _scatter(out, 2, nodes, scale, _turn(z0, z1, z2, z3, z4, z5, z6, z7))


@njit(cache=True)
def _gap(corner, face, normal, u):
    """How far the two sides of a face (cell, cell beyond, axis) have moved apart along its normal."""
    low, high, axis = face
    step = 4 >> axis
    gap = 0.0
    for k in range(8):
        if k & step:
            a, b = corner[low, k], corner[high, k - step]
            for i in range(3):
                gap += 0.25 * (u[b, i] - u[a, i]) * normal[i]
    return gap


@njit(cache=True)
def _push(corner, face, force, out):
    """Add `force` on the lower side of a face and its opposite on the upper side, spread over the corners."""
    low, high, axis = face
    step = 4 >> axis
    for k in range(8):
        if k & step:
            a, b = corner[low, k], corner[high, k - step]
            for i in range(3):
                out[a, i] += 0.25 * force[i]
                out[b, i] -= 0.25 * force[i]


@njit(cache=True)
def _press(corner, faces, normals, closed, stiffness, u, out):
    """Add the resistance of closed faces to out."""
    for q in range(len(faces)):
        if closed[q]:
            gap = _gap(corner, faces[q], normals[q], u)
            _push(corner, faces[q], -stiffness * gap * normals[q], out)


@njit(cache=True)
def _closed(corner, faces, normals, u):
    closed = np.zeros(len(faces), np.bool_)
    for q in range(len(faces)):
        closed[q] = _gap(corner, faces[q], normals[q], u) < 0
    return closed


@njit(cache=True)
def _release(corner, faces, tractions, area, out):
    """Add the loads that take `tractions` (on the lower side, n outward) off both sides of the faces."""
    for q in range(len(faces)):
        _push(corner, faces[q], -area * tractions[q], out)


@njit(cache=True)
def _times(corner, blocks, scale, mass, faces, normals, closed, penalty, u, out):
    """out = (mass + stiffness + resistance of closed faces) u."""
    out[:] = mass * u
    _multiply(corner, blocks, scale, u, out)
    _press(corner, faces, normals, closed, penalty, u, out)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _dot(a, b):
    total = 0.0
    for q in range(a.size):
        total += a.flat[q] * b.flat[q]
    return total


@njit(cache=True, fastmath={"reassoc", "contract"})
def _descend(x, residual, direction, moved, inverse, length):
    """Go `length` along the direction. Returns the new product of residual and preconditioned residual."""
    product = 0.0
    for q in range(len(x)):
        x[q] += length * direction[q]
        residual[q] -= length * moved[q]
        product += residual[q] * inverse[q] * residual[q]
    return product


@njit(cache=True)
def _conjugate_gradients(
    corner, blocks, scale, mass, diagonal, faces, normals, closed, penalty, right, x, enough, most
):
    """Solve for x (n, 3), in place from its value, until the residual is `enough`, preconditioned by the `diagonal`
    (n, 1). Returns the iterations."""
    moved = np.empty_like(x)
    _times(corner, blocks, scale, mass, faces, normals, closed, penalty, x, moved)
    residual = right - moved
    inverse = np.ones_like(x) / diagonal
    direction = inverse * residual
    product = _dot(residual, direction)
    for iteration in range(most):
        if _dot(residual, residual) <= enough * enough:
            return iteration
        _times(corner, blocks, scale, mass, faces, normals, closed, penalty, direction, moved)
        length, before = product / _dot(direction, moved), product
        product = _descend(x.ravel(), residual.ravel(), direction.ravel(), moved.ravel(), inverse.ravel(), length)
        direction = inverse * residual + product / before * direction
    return most


@dataclass(eq=False)
class CrackedSolid:
    """The change of displacement that cracks make. Starts uncracked and at rest; `part`, then `advance`."""

    cells: Ints
    """Index of each cell on its lattice, shape (n, 3)."""
    spacing: float
    """Side of a cell [m]."""
    young: float
    poisson: float
    density: float
    index: Numbers
    """Number of the cell at each place of the lattice, -1 where there is none, shape (nx, ny, nz)."""
    parted: NDArray[np.uint8]
    """Whether the face towards the next cell along each axis is open, shape (n, 3)."""
    corner: Numbers
    """Node of each corner, shape (n, 8)."""
    displacement: Floats
    """[m], shape (nodes, 3)."""
    velocity: Floats
    """[m/s], shape (nodes, 3)."""
    faces: Ints = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    """Open faces: cell, cell beyond, axis, shape (f, 3)."""
    normals: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    """Crack normal at each open face, towards the cell beyond, shape (f, 3)."""
    hardest: float = 0.0
    """Largest load of any step so far [N]: as it fades nothing has to be known better."""
    fresh: int = 0
    """How many of the faces, the last ones, have opened since the last step."""
    contact: bool = True
    """Whether faces that are pressed together carry the pressure."""
    iterations: int = 0
    """Of the conjugate gradients, in all."""

    @staticmethod
    def on(
        inside: NDArray[np.bool_], *, spacing: float, young: float, poisson: float, density: float, contact: bool = True
    ) -> CrackedSolid:
        """A whole solid of the cells where `inside` (nx, ny, nz) is true."""
        if not inside.any():
            raise BadInput("inside must contain at least one cell")
        cells = np.argwhere(inside)
        index = np.full(inside.shape, -1, np.int32)
        index[inside] = np.arange(len(cells))
        parted = np.zeros((len(cells), 3), np.uint8)
        corner, nodes = _number_corners(index, parted, cells)
        still = np.zeros((nodes, 3))
        return CrackedSolid(
            cells, spacing, young, poisson, density, index, parted, corner, still, still.copy(), contact=contact
        )

    @property
    def openings(self) -> Floats:
        """How far the two sides of each open face stand apart [m], shape (f, 3)."""
        return self._mean(self.faces[:, 1], self.faces[:, 2], 0) - self._mean(self.faces[:, 0], self.faces[:, 2], 1)

    def part(self, faces: Ints, normals: Floats) -> None:
        """Open faces (cell, cell beyond, axis), shape (k, 3), with the crack's `normals` (k, 3) towards beyond."""
        new = self.parted[faces[:, 0], faces[:, 2]] == 0
        if not new.any():
            return
        faces, normals = faces[new], normals[new]
        self.parted[faces[:, 0], faces[:, 2]] = 1
        old, before = self.corner, (self.displacement, self.velocity)
        self.corner, nodes = _number_corners(self.index, self.parted, self.cells)
        self.displacement, self.velocity = (self._renumbered(old, value, nodes) for value in before)
        self.faces = np.concatenate([self.faces, faces])
        self.normals = np.concatenate([self.normals, normals])
        self.fresh += len(faces)

    def advance(self, stress: Floats, step: float) -> None:
        """One implicit Euler step of `step` seconds (inf: to rest) under the uncracked `stress` (n, 6) [Pa].

        Raises NoSolution when the step does not converge."""
        if not len(self.faces):
            return
        load = np.zeros_like(self.displacement)
        _release(self.corner, self.faces, self._tractions(stress), self.spacing**2, load)
        self.hardest = max(self.hardest, float(np.linalg.norm(load)))
        mass = self._masses()[:, None] / step**2
        guess = self.displacement + (self.velocity * step if np.isfinite(step) else 0.0)
        right = load + mass * guess
        moved = guess.copy()
        closed = self._closed(moved)
        if self.fresh and self.contact:  # they have not moved yet: what they carried tells where they go
            closed[-self.fresh :] = self._across(stress + self.stress())[-self.fresh :] < 0
        self.fresh = 0
        for _ in range(CONTACT_ROUNDS):
            moved = self._solve(right, mass, closed, moved)
            now = self._closed(moved)
            if (now != closed).mean() <= SETTLED:
                break
            closed = now
        if np.isfinite(step):
            self.velocity = (moved - self.displacement) / step
        self.displacement = moved

    def stress(self) -> Floats:
        """What the cracks add to the stress at the cells' centres [Pa], shape (n, 6): xx, yy, zz, yz, xz, xy."""
        centre = _strain_of(_corner_gradients(np.full(3, 0.5)))
        law = self.young / self.spacing * elasticity(self.poisson) @ centre
        return self.displacement[self.corner].reshape(-1, 24) @ law.T

    def _solve(self, right: Floats, mass: Floats, closed: NDArray[np.bool_], start: Floats) -> Floats:
        """The displacement (nodes, 3) that balances `right` with `mass` (nodes, 1) [N/m] and these faces closed."""
        blocks, scale = _modal_stiffness(self.poisson), self.young * self.spacing
        touching = np.bincount(self.corner.ravel(), minlength=len(start))[:, None]
        diagonal = mass + scale * touching * np.trace(blocks.sum(axis=0)) / 3
        moved = start.copy()
        iterations = _conjugate_gradients(
            self.corner, blocks, scale, mass, diagonal, self.faces, self.normals, closed,
            CONTACT_STIFFNESS * scale, right, moved, TOLERANCE * self.hardest, MOST_ITERATIONS,
        )  # fmt: skip
        if iterations == MOST_ITERATIONS:
            raise NoSolution(f"the stress of the cracked body did not converge in {MOST_ITERATIONS} iterations")
        self.iterations += iterations
        return moved

    def _closed(self, displacement: Floats) -> NDArray[np.bool_]:
        """Which open faces are pressed together."""
        if not self.contact:
            return np.zeros(len(self.faces), bool)
        return _closed(self.corner, self.faces, self.normals, displacement)

    def _across(self, stress: Floats) -> Floats:
        """Stress across the crack at each open face, positive where it is pulled [Pa], shape (f,)."""
        mean = 0.5 * (stress[self.faces[:, 0]] + stress[self.faces[:, 1]])
        x, y, z = self.normals.T
        return np.einsum("fq,qf->f", mean, np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y]))

    def _tractions(self, stress: Floats) -> Floats:
        """Uncracked traction on the lower side of each open face [Pa], shape (f, 3)."""
        mean = 0.5 * (stress[self.faces[:, 0]] + stress[self.faces[:, 1]])
        rows = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
        return np.take_along_axis(mean, rows[self.faces[:, 2]], axis=1)

    def _masses(self) -> Floats:
        share = self.density * self.spacing**3 / 8
        return share * np.bincount(self.corner.ravel(), minlength=len(self.displacement)).astype(float)

    def _renumbered(self, old: Numbers, values: Floats, nodes: int) -> Floats:
        new = np.zeros((nodes, 3))
        new[self.corner.ravel()] = values[old.ravel()]
        return new

    def _mean(self, cells: Ints, axes: Ints, side: int) -> Floats:
        """Mean displacement of the corners of `cells` on one side along `axes`, shape (f, 3)."""
        on_side = CORNERS.T[axes] == side  # (f, 8)
        return np.einsum("fk,fki->fi", on_side / 4, self.displacement[self.corner[cells]])
