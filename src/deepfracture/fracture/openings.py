"""Which faces of the coarse cells a crack on the fine lattice opens, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.fracture.body import FractureBody
from deepfracture.fracture.cracked import CrackedSolid
from deepfracture.fracture.growth import Crack, Front
from deepfracture.types import Floats, Ints


@njit(cache=True)
def _crossed(cells, index, known, middle, cut, status, position, arrival, normals):
    """Faces of coarse cells that the fine cuts of the current crack cross on the straight way between centres."""
    found = []
    for q in range(len(cells)):
        for axis in range(3):
            if known[q, axis]:
                continue
            x, y, z = cells[q, 0], cells[q, 1], cells[q, 2]
            a, b, c = x + (axis == 0), y + (axis == 1), z + (axis == 2)
            if max(a, b, c) >= index.shape[0] or index[a, b, c] < 0:
                continue
            i, j, k = middle[x], middle[y], middle[z]
            for _ in range(middle[cells[q, axis] + 1] - middle[cells[q, axis]]):
                if cut[i, j, k] & (1 << axis) and status[i, j, k] != 0:
                    p = position[i, j, k]
                    side = 1.0 if normals[p, axis] >= 0 else -1.0
                    found.append(
                        (
                            float(q),
                            float(index[a, b, c]),
                            float(axis),
                            arrival[p],
                            side * normals[p, 0],
                            side * normals[p, 1],
                            side * normals[p, 2],
                        )
                    )
                    known[q, axis] = True
                    break
                i, j, k = i + (axis == 0), j + (axis == 1), k + (axis == 2)
    return found


@dataclass(frozen=True, eq=False)
class Openings:
    """Faces of coarse cells that a crack has reached or will reach."""

    known: np.ndarray
    """Whether the face of a cell towards the next along each axis is open or will be, shape (n, 3)."""
    faces: Ints
    """Those still to be opened: cell, cell beyond, axis, shape (f, 3)."""
    normals: Floats
    """Crack normal, towards the cell beyond, shape (f, 3)."""
    times: Floats
    """When the front comes by [s], shape (f,)."""

    @staticmethod
    def none(solid: CrackedSolid) -> Openings:
        return Openings(solid.parted.astype(bool), np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros(0))

    def __len__(self) -> int:
        return len(self.times)

    def add(self, body: FractureBody, crack: Crack, front: Front, position: np.ndarray) -> Openings:
        """With what `crack` opens; `position` has the number of each of its voxels."""
        if not len(crack.voxels):
            return self
        coarse, fine = body.coarse, body.fine
        centres = coarse.first_centre + coarse.spacing * np.arange(coarse.n)
        middle = np.clip(np.round((centres - fine.first_centre) / fine.spacing).astype(np.int64), 0, fine.n - 1)
        index = np.full(coarse.shape, -1, np.int64)
        index[tuple(body.cells.T)] = np.arange(len(body.cells))
        known = self.known.copy()
        new = np.array(
            _crossed(
                body.cells, index, known, middle, front.cut, front.status, position, crack.arrival,
                np.ascontiguousarray(crack.normals),
            )
        ).reshape(-1, 7)  # fmt: skip
        return Openings(
            known,
            np.concatenate([self.faces, new[:, :3].astype(np.int64)]),
            np.concatenate([self.normals, new[:, 4:]]),
            np.concatenate([self.times, new[:, 3]]),
        )

    def release(self, solid: CrackedSolid, time: float) -> Openings:
        """Open in `solid` what is due by `time` [s]. Returns what is left."""
        due = self.times <= time
        solid.part(self.faces[due], self.normals[due])
        return Openings(self.known, self.faces[~due], self.normals[~due], self.times[~due])
