"""What the paper's own method took: Huang and Kanai 2024, the table of computation times, r = 128 and 256."""

from __future__ import annotations

PAPER = "paper, Ryzen 9 5950X"
SECONDS = {
    ("predict", "pot", 128): 0.30,
    ("predict", "pot", 256): 0.35,
    ("segment", "pot", 128): 2.25,
    ("segment", "pot", 256): 17.17,
    ("cut", "pot", 128): 3.71,
    ("cut", "pot", 256): 11.31,
    ("predict", "squirrel", 128): 0.22,
    ("predict", "squirrel", 256): 0.23,
    ("segment", "squirrel", 128): 2.49,
    ("segment", "squirrel", 256): 18.22,
    ("cut", "squirrel", 128): 6.01,
    ("cut", "squirrel", 256): 18.14,
}


def paper_seconds(stage: str, shape: str, resolution: int) -> tuple[str, float | None]:
    """Source and time of a stage in the paper; no source where it has none."""
    found = SECONDS.get((stage, shape, resolution))
    return (PAPER if found else "", found)
