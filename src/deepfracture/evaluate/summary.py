"""From the measurements to a few figures per source, with bootstrap intervals over the collisions."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepfracture.compare import MEASURES
from deepfracture.compare.distances import kolmogorov_smirnov
from deepfracture.evaluate.evaluation import Evaluation
from deepfracture.evaluate.sensitivity import SIMULATION, rank_correlation
from deepfracture.types import Floats, Ints

RESAMPLES = 1000
CONFIDENCE = 0.95
BASELINE = "nearest"
"""The source that every other is also compared with, collision by collision."""


@dataclass(frozen=True)
class Interval:
    """A figure and its bootstrap interval of CONFIDENCE (Efron 1979)."""

    value: float
    low: float
    high: float

    @staticmethod
    def of(values: Sequence[float] | Floats) -> Interval:
        """The first value is that of the whole, the others those of bootstrap samples; NaN is left out."""
        known = np.asarray(values[1:], float)
        known = known[np.isfinite(known)]
        if not len(known):
            return Interval(float(values[0]), float("nan"), float("nan"))
        low, high = np.quantile(known, (0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2))
        return Interval(float(values[0]), float(low), float(high))

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


@dataclass(frozen=True)
class Summary:
    """The scores of one source."""

    score: Interval
    """Mean of `measures`; 1: as near to a simulation as another simulation is. Lower is better."""
    measures: dict[str, Interval]
    """Mean distance to the simulations over the mean floor, for each of `compare.MEASURES`. NaN, and no part of
    the score, where the floor is zero: that takes very few collisions."""
    against_nearest: Interval | None
    """Score minus that of BASELINE on the same collisions: surely better if all of it is below zero."""
    diversity: Interval
    """Mean distance between draws over the floor, mean over the measures: 1 as various as simulations, 0 always the
    same. NaN for a single draw."""
    energy: Interval
    """(2 distance - distance between draws - floor) / floor, mean over the measures: the energy distance of two
    distributions (Szekely and Rizzo 2013). 0 only if draws are spread as simulations are; a single guess, however
    central, cannot have it. NaN for a single draw."""
    bias: Interval
    """Mean of predicted minus simulated count, relative to the mean simulated count."""
    rising: Interval
    """Rank correlation of fragment count and impulse."""
    sensitivity: float
    """See `sensitivity.sensitivities`."""
    volumes: float
    """Kolmogorov and Smirnov's distance of all fragment volumes to all of the simulations'."""
    mott: float
    """The same of V / V_mean, V_mean of each collision, to Mott's exp(-(6 V / V_mean)^(1/3))."""
    milliseconds: float
    """Median time of a call [ms]."""
    stages: dict[str, float]
    """Median time of its stages [ms]."""


def summarise(evaluation: Evaluation) -> dict[str, Summary]:
    """By the names of the sources. The same evaluation gives the same intervals."""
    tables = {name: _Table.of(evaluation, name) for name in evaluation.sources}
    resamples = _Resamples.of(evaluation)
    return {name: _summary(evaluation, name, tables, resamples) for name in tables}


def score_samples(evaluation: Evaluation) -> dict[str, Floats]:
    """The score of every source, followed by those of all bootstrap samples, shape (1 + RESAMPLES,): what is needed
    for the interval of something made of several scores."""
    resamples = _Resamples.of(evaluation)
    return {name: _mean(_Table.of(evaluation, name).scores(resamples)) for name in evaluation.sources}


def simulated(evaluation: Evaluation) -> dict[str, float]:
    """The same figures for the simulations themselves, where they are defined."""
    counts = [count for collision in evaluation.collisions for count in collision.counts]
    impulses = [collision.impulse for collision in evaluation.collisions for _ in collision.counts]
    return {
        "count": float(np.mean(counts)),
        "rising": float(rank_correlation(np.array(impulses), np.array(counts, float))),
        "sensitivity": evaluation.sensitivity[SIMULATION],
        "mott": mott_distance([volumes for collision in evaluation.collisions for volumes in collision.volumes]),
    }


def floors(evaluation: Evaluation) -> dict[str, float]:
    """Mean floor of each measure, in its own unit."""
    return {name: float(np.mean([one.floor[name] for one in evaluation.collisions])) for name in MEASURES}


def mott_larger(size: Floats) -> Floats:
    """Mott's share of fragments larger than `size` = V / V_mean (Mott and Linfoot 1943)."""
    return np.exp(-np.cbrt(6 * size))


def relative_volumes(volumes: Sequence[Sequence[float]]) -> Floats:
    """V / V_mean of all fragments, V_mean of each pattern, ascending."""
    return np.sort(np.concatenate([np.asarray(one, float) / np.mean(one) for one in volumes]))


def mott_distance(volumes: Sequence[Sequence[float]]) -> float:
    """Kolmogorov and Smirnov's distance of the fragments of many patterns to Mott's distribution."""
    sizes = relative_volumes(volumes)
    wanted, steps = 1 - mott_larger(sizes), np.arange(len(sizes) + 1) / len(sizes)
    return float(max((steps[1:] - wanted).max(), (wanted - steps[:-1]).max()))


@dataclass(frozen=True, eq=False)
class _Table:
    """The measurements of one source as arrays; c collisions, d draws, m measures."""

    floor: Floats
    """(c, m)"""
    distance: Floats
    """(c, d, m)"""
    apart: Floats
    """Between draws, (c, m); NaN for a single draw."""
    count: Floats
    """(c, d)"""
    truth: Floats
    """Mean count of the repeats, (c,)."""
    impulse: Floats
    """[N s], (c,)."""

    @staticmethod
    def of(evaluation: Evaluation, name: str) -> _Table:
        rows = evaluation.collisions
        answers = [row.answers[name] for row in rows]
        return _Table(
            np.array([[row.floor[m] for m in MEASURES] for row in rows]),
            np.array([[[draw[m] for m in MEASURES] for draw in answer.distances] for answer in answers]),
            np.array([[answer.apart.get(m, np.nan) for m in MEASURES] for answer in answers]),
            np.array([answer.counts for answer in answers], float),
            np.array([np.mean(row.counts) for row in rows]),
            np.array([row.impulse for row in rows]),
        )

    def scores(self, resamples: _Resamples) -> Floats:
        """Of each measure, (b, m)."""
        return self._over_floor(
            self.distance[resamples.collisions[:, :, None], resamples.draws].mean(axis=(1, 2)), resamples
        )

    def diversity(self, resamples: _Resamples) -> Floats:
        """Of each measure, (b, m)."""
        return self._over_floor(self.apart[resamples.collisions].mean(axis=1), resamples)

    def energy(self, resamples: _Resamples) -> Floats:
        """Of each measure, (b, m)."""
        return 2 * self.scores(resamples) - self.diversity(resamples) - 1

    def bias(self, resamples: _Resamples) -> Floats:
        """(b,)"""
        return self._counts(resamples).mean(axis=(1, 2)) / self.truth[resamples.collisions].mean(axis=1) - 1

    def rising(self, resamples: _Resamples) -> Floats:
        """(b,)"""
        counts = self._counts(resamples)
        impulses = np.broadcast_to(self.impulse[resamples.collisions][:, :, None], counts.shape)
        return rank_correlation(impulses.reshape(len(counts), -1), counts.reshape(len(counts), -1))

    def _counts(self, resamples: _Resamples) -> Floats:
        return self.count[resamples.collisions[:, :, None], resamples.draws]

    def _over_floor(self, distance: Floats, resamples: _Resamples) -> Floats:
        floor = self.floor[resamples.collisions].mean(axis=1)
        return np.divide(distance, floor, out=np.full(floor.shape, np.nan), where=floor > 0)


@dataclass(frozen=True, eq=False)
class _Resamples:
    """Indices of b bootstrap samples, the first of which is the whole."""

    collisions: Ints
    """(b, c)"""
    draws: Ints
    """Of each of them, (b, c, d)."""

    @staticmethod
    def of(evaluation: Evaluation) -> _Resamples:
        """The whole, then RESAMPLES samples with replacement: the same for every source, others for every shape."""
        c, d = len(evaluation.collisions), evaluation.draws
        rng = np.random.default_rng([evaluation.seed, zlib.crc32(evaluation.shape.encode())])
        collisions = rng.integers(c, size=(RESAMPLES + 1, c))
        draws = rng.integers(d, size=(RESAMPLES + 1, c, d))
        collisions[0], draws[0] = np.arange(c), np.arange(d)
        return _Resamples(collisions, draws)


def _mean(scores: Floats) -> Floats:
    """Over the measures that have a floor, shape (..., m) to (...); NaN where none has."""
    known = np.isfinite(scores)
    sums, number = np.where(known, scores, 0).sum(axis=-1), known.sum(axis=-1)
    return np.divide(sums, number, out=np.full(sums.shape, np.nan), where=number > 0)


def _summary(evaluation: Evaluation, name: str, tables: dict[str, _Table], resamples: _Resamples) -> Summary:
    table = tables[name]
    answers = [collision.answers[name] for collision in evaluation.collisions]
    scores = table.scores(resamples)
    overall = _mean(scores)
    against = None
    if BASELINE in tables and name != BASELINE:
        against = Interval.of(overall - _mean(tables[BASELINE].scores(resamples)))
    volumes = [one for answer in answers for one in answer.volumes]
    truth = [one for collision in evaluation.collisions for one in collision.volumes]
    stages = {stage for answer in answers for draw in answer.stages for stage in draw}
    return Summary(
        score=Interval.of(overall),
        measures={measure: Interval.of(scores[:, m]) for m, measure in enumerate(MEASURES)},
        against_nearest=against,
        diversity=Interval.of(_mean(table.diversity(resamples))),
        energy=Interval.of(_mean(table.energy(resamples))),
        bias=Interval.of(table.bias(resamples)),
        rising=Interval.of(table.rising(resamples)),
        sensitivity=evaluation.sensitivity[name],
        volumes=kolmogorov_smirnov(np.sort(np.concatenate(volumes)), np.sort(np.concatenate(truth))),
        mott=mott_distance(volumes),
        milliseconds=1e3 * float(np.median([answer.seconds for answer in answers])),
        stages={
            stage: 1e3 * float(np.median([draw.get(stage, 0.0) for answer in answers for draw in answer.stages]))
            for stage in sorted(stages)
        },
    )
