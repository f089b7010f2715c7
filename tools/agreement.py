"""Whether the performance model (paper section III-E) agrees with what many flights showed."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.judging.risk import Floats, interval
from tools.assessment import Figure, Report

RESAMPLES = 2000


class Expectation(NamedTuple):
    """Overrides in one flight's test phase; NaN where nothing tells."""

    flight: str
    from_learning: Figure
    """What the robot could know before the test phase."""
    from_test: Figure
    observed: float


class Agreement(NamedTuple):
    """Sums over the flights for which all three are known, and observed / expected."""

    flights: int
    from_learning: float
    from_test: float
    observed: float
    ratio_learning: Figure
    """Its interval is a bootstrap's over flights."""
    ratio_test: Figure


def expectation(report: Report) -> Expectation:
    """Probability per approach, times the approaches that mono flew."""
    approaches = report.observed.mono_approaches
    learning, test = report.from_learning.override, report.from_test.override
    observed = report.observed.override * approaches
    return Expectation(
        report.flight, _times(learning, approaches), _times(test, approaches), observed
    )


def agreement(expectations: Sequence[Expectation], rng: np.random.Generator) -> Agreement:
    """Over flights of one kind, or of several together."""
    rows = np.array([(e.from_learning.value, e.from_test.value, e.observed) for e in expectations])
    known = rows.reshape(-1, 3)[~np.isnan(rows.reshape(-1, 3)).any(axis=1)]
    learning, test, observed = known.sum(axis=0)
    return Agreement(
        flights=len(known),
        from_learning=float(learning),
        from_test=float(test),
        observed=float(observed),
        ratio_learning=_ratio(known[:, 2], known[:, 0], rng),
        ratio_test=_ratio(known[:, 2], known[:, 1], rng),
    )


def _ratio(observed: Floats, expected: Floats, rng: np.random.Generator) -> Figure:
    if not expected.sum() > 0.0:
        return Figure(math.nan, math.nan, math.nan)
    drawn = rng.integers(len(observed), size=(RESAMPLES, len(observed)))
    sums = expected[drawn].sum(axis=1)
    ratios = np.divide(
        observed[drawn].sum(axis=1), sums, out=np.full(RESAMPLES, np.nan), where=sums > 0.0
    )
    low, high = interval(ratios)
    return Figure(float(observed.sum() / expected.sum()), float(low), float(high))


def _times(figure: Figure, count: int) -> Figure:
    return Figure(figure.value * count, figure.low * count, figure.high * count)
