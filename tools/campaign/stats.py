"""Rows of flights to means, deviations and tests between groups (paper section V)."""

import itertools
import math
import statistics
import zlib
from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from tools.campaign.rows import Row

RESAMPLES = 10_000
CONFIDENCE = 0.95
COMPARED = ("overrides", "turns", "collisions", "coverage_norm")
"""Figures that groups are tested on."""
DESCRIBED = (*COMPARED, "mse", "fpr", "tpr", "auc")

Floats = NDArray[np.float64]


class Figure(msgspec.Struct, frozen=True):
    """Mean and standard deviation over flights; NaN of too few."""

    mean: float
    sigma: float
    n: int


class Group(msgspec.Struct, frozen=True, kw_only=True):
    """The flights of one kind. ``figures`` are of those flown to the end of the plan.

    Collisions, distance and time are sums over the test phases of all flights that got there.
    """

    name: str
    flown: int
    failed: int
    figures: dict[str, Figure]
    collisions: int
    distance_flown_m: float
    test_s: float
    collisions_per_min: float
    distance_per_collision_m: float
    """NaN when there was none."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """One figure of two groups: mean of ``second`` minus mean of ``first``."""

    figure: str
    first: str
    second: str
    difference: float
    low: float
    """Of the CONFIDENCE interval of the difference, by percentiles of the bootstrap."""
    high: float
    p: float
    """Two-sided: how often chance alone makes means differ as much."""


class Table(msgspec.Struct, frozen=True, kw_only=True):
    """All that a campaign says."""

    groups: list[Group]
    comparisons: list[Comparison]
    seed: int
    """Of the resampling."""


def tabulate(rows: Sequence[Row], names: Sequence[str], seed: int = 0) -> Table:
    """The groups in the order of ``names``, whatever the order of the rows."""
    ordered = sorted(rows, key=lambda row: (row.group, row.seed))
    by_group = {name: [row for row in ordered if row.group == name] for name in names}
    comparisons = []
    for figure, (first, second) in itertools.product(COMPARED, itertools.combinations(names, 2)):
        values = [_values(by_group[name], figure) for name in (first, second)]
        if min(map(len, values)) >= 2:
            key = zlib.crc32(f"{figure}/{first}/{second}".encode())
            rng = np.random.default_rng([seed, key])
            comparisons.append(_compare(figure, (first, second), values[0], values[1], rng))
    groups = [_group(name, by_group[name]) for name in names]
    return Table(groups=groups, comparisons=comparisons, seed=seed)


def two_sided_p(first: Floats, second: Floats, rng: np.random.Generator) -> float:
    """Bootstrap test that two samples have one mean (Cohen, Empirical Methods for AI, chapter 5).

    If the groups are alike, both are draws from their union: p is the share of RESAMPLES pairs
    drawn from it, with replacement, whose means differ as much as those observed.
    """
    observed = abs(second.mean() - first.mean())
    union = np.concatenate([first, second])
    draws = rng.choice(union, (RESAMPLES, len(union)))
    differences = np.abs(draws[:, : len(first)].mean(axis=1) - draws[:, len(first) :].mean(axis=1))
    rounding = 1e-9 * max(observed, np.abs(union).max())
    as_large = int((differences >= observed - rounding).sum())
    return (as_large + 1) / (RESAMPLES + 1)


def _compare(
    figure: str,
    names: tuple[str, str],
    first: Floats,
    second: Floats,
    rng: np.random.Generator,
) -> Comparison:
    p = two_sided_p(first, second, rng)
    interval = bootstrap(
        (first, second),
        lambda a, b, axis: b.mean(axis=axis) - a.mean(axis=axis),
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        vectorized=True,
        random_state=rng,
    ).confidence_interval
    return Comparison(
        figure=figure,
        first=names[0],
        second=names[1],
        difference=float(second.mean() - first.mean()),
        low=float(interval.low),
        high=float(interval.high),
        p=p,
    )


def _values(rows: Sequence[Row], figure: str) -> Floats:
    """Of the flights flown to the end that know it."""
    values = [getattr(row, figure) for row in rows if row.outcome == "flown"]
    known = [float(value) for value in values if value is not None]
    return np.array([value for value in known if not math.isnan(value)])


def _group(name: str, rows: Sequence[Row]) -> Group:
    flown = sum(row.outcome == "flown" for row in rows)
    collisions = sum(row.collisions or 0 for row in rows)
    distance_flown_m = math.fsum(row.distance_flown_m or 0.0 for row in rows)
    test_s = math.fsum(row.test_s or 0.0 for row in rows)
    return Group(
        name=name,
        flown=flown,
        failed=len(rows) - flown,
        figures={figure: _describe(_values(rows, figure)) for figure in DESCRIBED},
        collisions=collisions,
        distance_flown_m=distance_flown_m,
        test_s=test_s,
        collisions_per_min=60.0 * collisions / test_s if test_s > 0 else math.nan,
        distance_per_collision_m=distance_flown_m / collisions if collisions else math.nan,
    )


def _describe(values: Floats) -> Figure:
    count = len(values)
    mean = float(values.mean()) if count else math.nan
    sigma = statistics.stdev(values.tolist()) if count > 1 else math.nan
    return Figure(mean, sigma, count)
