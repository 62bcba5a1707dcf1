"""The faces of the coarse cells that a crack on the fine grid opens, and when its front passes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from deepfracture.fracture.body import FractureBody
from deepfracture.fracture.cracked_solid import CrackedSolid
from deepfracture.fracture.growth import Crack, MarchState
from deepfracture.types import Floats, Ints


@njit(cache=True)
def _crossed(cells, index, known, middle, march, position, crack):
    """Faces of coarse cells for which a face cut by the current crack lies on the straight line between the centres."""
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
                if march.cut[i, j, k] & (1 << axis) and march.status[i, j, k] != 0:
                    p = position[i, j, k]
                    sign = 1.0 if crack.normals[p, axis] >= 0 else -1.0
                    found.append(
                        (
                            float(q),
                            float(index[a, b, c]),
                            float(axis),
                            crack.arrival[p],
                            sign * crack.normals[p, 0],
                            sign * crack.normals[p, 1],
                            sign * crack.normals[p, 2],
                        )
                    )
                    known[q, axis] = True
                    break
                i, j, k = i + (axis == 0), j + (axis == 1), k + (axis == 2)
    return found


@dataclass(frozen=True, eq=False)
class PendingFaces:
    """Faces of coarse cells that cracks have cut but the solid has not opened yet."""

    known: np.ndarray
    """Whether the face of a cell towards the next along each axis is open or pending, shape (n, 3)."""
    faces: Ints
    """Pending faces: cell, cell beyond, axis, shape (f, 3)."""
    normals: Floats
    """Crack normal, towards the cell beyond, shape (f, 3)."""
    times: Floats
    """When the crack front passes [s], shape (f,)."""

    @staticmethod
    def none(solid: CrackedSolid) -> PendingFaces:
        return PendingFaces(solid.is_open.astype(bool), np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros(0))

    def __len__(self) -> int:
        return len(self.times)

    def add(self, body: FractureBody, crack: Crack, march: MarchState, position: np.ndarray) -> PendingFaces:
        """Also the faces that `crack` cuts; `position` holds the index of each of its voxels."""
        if not len(crack.voxels):
            return self
        coarse, fine = body.coarse, body.fine
        centres = coarse.first_centre + coarse.spacing * np.arange(coarse.n)
        middle = np.clip(np.round((centres - fine.first_centre) / fine.spacing).astype(np.int64), 0, fine.n - 1)
        index = np.full(coarse.shape, -1, np.int64)
        index[tuple(body.cells.T)] = np.arange(len(body.cells))
        known = self.known.copy()
        new = np.array(_crossed(body.cells, index, known, middle, march, position, crack)).reshape(-1, 7)
        return PendingFaces(
            known,
            np.concatenate([self.faces, new[:, :3].astype(np.int64)]),
            np.concatenate([self.normals, new[:, 4:]]),
            np.concatenate([self.times, new[:, 3]]),
        )

    def open_due(self, solid: CrackedSolid, time: float) -> PendingFaces:
        """Open the faces in `solid` that the front passes by `time` [s]. Returns the others."""
        due = self.times <= time
        solid.open_faces(self.faces[due], self.normals[due])
        return PendingFaces(self.known, self.faces[~due], self.normals[~due], self.times[~due])
