"""Arrays that lie on disk: what a training looks at again and again, and what together need not fit into memory.

The system keeps in memory what fits and reads the rest, so a small data set is as quick as before."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike, NDArray

from deepfracture.types import BadInput


def on_disk(folder: Path, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray:
    """An array of zeros in a file of its own in `folder`. The file has no name: it is gone with the process, however
    that ends.

    Raises:
        BadInput: There is no room for it."""
    size = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            if hasattr(os, "posix_fallocate"):  # a full disk must be found now: later it would end the process
                os.posix_fallocate(file.fileno(), 0, size)
            return np.memmap(file, dtype, "w+", shape=shape)
    except OSError as error:
        raise BadInput(
            f"{folder}: no room for {size / 1e6:.0f} MB while training ({error.strerror}); free some and run again"
        ) from error


def spilt(folder: Path, array: NDArray) -> NDArray:
    """A copy of `array` on disk."""
    copy = on_disk(folder, array.shape, array.dtype)
    copy[...] = array
    return copy
