"""Every case at its full size, and at a size that a test can afford; the limits are the same."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from deepfracture.validation import beam, breaking, collisions, elastic, penny
from deepfracture.validation.report import Finding, Plot, Report


@dataclass(frozen=True, eq=False)
class Case:
    """One case in two sizes."""

    full: Callable[[], Report]
    quick: Callable[[], Report]


@dataclass(frozen=True, eq=False)
class CaseResult:
    """A case that has been run."""

    name: str
    report: Report
    seconds: float

    @property
    def rows(self) -> list[dict[str, str | float | bool]]:
        """The findings as plain values; `seconds` is what the whole case took."""
        return [_row(finding, self.seconds) for finding in self.report.findings]

    @property
    def plots(self) -> tuple[Plot, ...]:
        return self.report.plots


def _row(found: Finding, seconds: float) -> dict[str, str | float | bool]:
    return {
        "case": found.case,
        "exact": found.exact,
        "ours": found.ours,
        "error": found.error,
        "limit": found.limit,
        "ok": found.ok,
        "n": found.n,
        "seconds": round(seconds, 2),
    }


def _sizes(case: Callable[..., Report], full: tuple, quick: tuple) -> Case:
    return Case(partial(case, *full), partial(case, *quick))


BODIES = ("cube", "sphere", "irregular", "plate")
CASES: Mapping[str, Case] = MappingProxyType(
    {
        "uniform-tension": _sizes(elastic.uniform_tension, (BODIES, 8), (BODIES, 5)),
        "rigid-motion": _sizes(elastic.rigid_motion, (BODIES, 8), (BODIES[2:], 5)),
        "hollow-sphere": _sizes(elastic.hollow_sphere, (((4, 3), (6, 5), (8, 6)),), (((4, 3), (5, 4), (8, 6)),)),
        "cantilever": _sizes(beam.cantilever, (30, 8), (24, 6)),
        "pinched-sphere": _sizes(elastic.pinched_sphere, (10,), (8,)),
        "pulled-bar": _sizes(elastic.pulled_bar, ((24, 6, 6),), ((12, 3, 3),)),
        "twisted-bar": _sizes(elastic.twisted_bar, (28, 24), (22, 19)),
        "hertz": _sizes(collisions.hertz_motion, (), ()),
        "load-balance": _sizes(collisions.load_balance, (8,), (4,)),
        "engine-momentum": _sizes(collisions.engine_momentum, (8.0,), (8.0,)),
        "penny-crack": _sizes(penny.penny_in_tension, (10.0, 30), (8.0, 20)),
        "inclined-penny": _sizes(penny.inclined_penny, (10.0, 30), (8.0, 20)),
        "below-strength": _sizes(breaking.below_strength, (64, 10), (32, 3)),
        "three-point-bend": _sizes(breaking.three_point_bend, (64, 10), (32, 3)),
        "near-shear": _sizes(breaking.near_shear, (64, 10), (64, 2)),
        "notched-plate": _sizes(breaking.notched_plate, (64, 10), (32, 3)),
        "toughness": _sizes(breaking.tougher, (64, 10), (32, 3)),
    }
)


def run_cases(*, quick: bool) -> Iterator[CaseResult]:
    """Run every case, one after the other."""
    for name, case in CASES.items():
        start = time.perf_counter()
        report = case.quick() if quick else case.full()
        yield CaseResult(name, report, time.perf_counter() - start)
