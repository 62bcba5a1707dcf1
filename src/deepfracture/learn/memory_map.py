"""Memory-mapped arrays: training data that is read again and again and need not fit into memory.

The system caches what fits, so a small data set is as fast as one in memory."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike, NDArray

from deepfracture.types import BadInput


def memory_map(folder: Path, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray:
    """An array of zeros in a file of its own in `folder`. The file is unlinked, so it goes with the process, however
    that ends.

    Raises:
        BadInput: The disk has no space for it."""
    size = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            if hasattr(os, "posix_fallocate"):  # finds a full disk here: later it would end the process
                os.posix_fallocate(file.fileno(), 0, size)
            return np.memmap(file, dtype, "w+", shape=shape)
    except OSError as error:
        raise BadInput(
            f"{folder}: no room for {size / 1e6:.0f} MB while training ({error.strerror}); free some and run again"
        ) from error


def memory_mapped(folder: Path, array: NDArray) -> NDArray:
    """A copy of `array` on disk."""
    copy = memory_map(folder, array.shape, array.dtype)
    copy[...] = array
    return copy
