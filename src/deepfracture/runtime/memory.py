"""How much memory this process has, and how it gives back what is free."""

from __future__ import annotations

import ctypes
import resource
import sys
from pathlib import Path


def peak_mb() -> float:
    """Highest resident memory of this process so far [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)


def resident_mb() -> float:
    """Resident memory of this process now; its highest so far where the system does not say [MB]."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return peak_mb()
    return pages * resource.getpagesize() / 1e6


def release_free_memory() -> None:
    """Give memory that is free back to the system.

    glibc keeps what each thread frees for that thread's next wish, so a process holds the most that it ever needed,
    and more: as many holes as it has threads. Other systems' libraries give memory back by themselves."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform.startswith("linux") else None
    if trim is not None:  # musl has none
        trim(0)
