"""Face-connected parts of a label field."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def connected_labels(labels: np.ndarray) -> np.ndarray:
    """Labels 1..n of the face-connected parts of every positive label, int32, shape as `labels` (3 axes)."""
    n0, n1, n2 = labels.shape
    parts = np.zeros(labels.shape, np.int32)
    stack = np.empty((labels.size, 3), np.int32)
    count = 0
    for i in range(n0):
        for j in range(n1):
            for k in range(n2):
                if labels[i, j, k] <= 0 or parts[i, j, k] != 0:
                    continue
                count += 1
                parts[i, j, k] = count
                stack[0] = i, j, k
                top = 1
                while top > 0:
                    top -= 1
                    at = stack[top, 0], stack[top, 1], stack[top, 2]
                    name = labels[at]
                    for n in range(6):
                        step = 1 - 2 * (n & 1)
                        x = at[0] + (step if n < 2 else 0)
                        y = at[1] + (step if 2 <= n < 4 else 0)
                        z = at[2] + (step if n >= 4 else 0)
                        if not (0 <= x < n0 and 0 <= y < n1 and 0 <= z < n2):
                            continue
                        if labels[x, y, z] == name and parts[x, y, z] == 0:
                            parts[x, y, z] = count
                            stack[top] = x, y, z
                            top += 1
    return parts
