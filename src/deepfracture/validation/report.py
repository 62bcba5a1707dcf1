"""What a case of the validation says: figures against their exact values, and a plot of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Finding:
    """One figure beside the value it should have."""

    case: str
    exact: float
    ours: float
    error: float
    """Relative, unless the case says otherwise."""
    limit: float
    """Largest `error` that passes."""
    n: int
    """Boundary elements, voxels along an axis, or whatever the case counts."""

    @staticmethod
    def relative(case: str, exact: float, ours: float, *, limit: float, n: int) -> Finding:
        """With the error |ours - exact| / |exact|."""
        return Finding(case, float(exact), float(ours), float(abs(ours - exact) / abs(exact)), limit, n)

    @property
    def ok(self) -> bool:
        return bool(self.error <= self.limit)  # a NaN is not ok


@dataclass(frozen=True, eq=False)
class Curve:
    """One line or set of marks of a plot."""

    label: str
    x: ArrayLike
    y: ArrayLike
    style: str = "o"
    """Of matplotlib: "o" marks, "-" a line."""


@dataclass(frozen=True, eq=False)
class Plot:
    """A figure in the making: no library is asked before it is drawn."""

    name: str
    """Of the file, without ending."""
    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve]
    log: bool = False
    """Both axes logarithmic."""


@dataclass(frozen=True, eq=False)
class Report:
    """What one case found."""

    findings: tuple[Finding, ...]
    plots: tuple[Plot, ...] = ()
