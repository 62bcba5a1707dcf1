"""Memory of this process, and its return to the system."""

from __future__ import annotations

import ctypes
import resource
import sys
from pathlib import Path


def peak_mb() -> float:
    """Peak resident memory of this process [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)


def resident_mb() -> float:
    """Resident memory of this process, or its peak where the system does not tell [MB]."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return peak_mb()
    return pages * resource.getpagesize() / 1e6


def release_free_memory() -> None:
    """Return free heap memory to the system.

    glibc keeps what each thread frees in that thread's arena, so a process holds its peak and more: the free blocks of
    every thread. Allocators of other systems return memory by themselves."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform.startswith("linux") else None
    if trim is not None:  # absent from musl
        trim(0)
