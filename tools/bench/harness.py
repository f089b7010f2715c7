"""Rows of figures, and races that make them."""

import math
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, Self

import msgspec

from companion.kernel.clock import wall_s

Better = Literal["less", "more"]
PLAN = Path(__file__).parents[2] / "flightplans" / "room1.toml"
"""What the rows about flights fly."""
WARM_UP = 3


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One figure; ``ratio`` is how many times better than the baseline it is."""

    name: str
    value: float
    unit: str
    better: Better = "less"
    goal: float | None = None
    baseline: str
    baseline_value: float
    ratio: float
    met: bool | None
    """None without a goal."""

    @classmethod
    def of(
        cls,
        name: str,
        value: float,
        unit: str,
        baseline: tuple[str, float],
        *,
        goal: float | None = None,
        better: Better = "less",
    ) -> Self:
        baseline_name, baseline_value = baseline
        less = better == "less"
        gained, over = (baseline_value, value) if less else (value, baseline_value)
        met = None if goal is None else (value <= goal if less else value >= goal)
        return cls(
            name=name,
            value=value,
            unit=unit,
            better=better,
            goal=goal,
            baseline=baseline_name,
            baseline_value=baseline_value,
            ratio=gained / over if over else math.inf,
            met=met,
        )


def race_s(
    calls: Sequence[Callable[[], object]], rounds: int, warm_up: int = WARM_UP, in_a_row: int = 1
) -> list[float]:
    """Median seconds of each call; the calls take turns, so that all meet the same noise.

    ``in_a_row``: calls of one kind before the other's turn; with 1, each finds the caches full of
    the other's data.
    """
    for call in calls:
        for _ in range(warm_up):
            call()
    times_s: list[list[float]] = [[] for _ in calls]
    for _ in range(rounds):
        for call, taken_s in zip(calls, times_s, strict=True):
            for _ in range(in_a_row):
                began_s = wall_s()
                call()
                taken_s.append(wall_s() - began_s)
    return [statistics.median(taken_s) for taken_s in times_s]


def race_row(
    name: str,
    call: Callable[[], object],
    baseline: tuple[str, Callable[[], object]],
    *,
    unit: Literal["ms", "us"] = "ms",
    goal: float | None = None,
    rounds: int = 300,
    warm_up: int = WARM_UP,
    in_a_row: int = 1,
) -> Row:
    """A row of two calls that do the same work; see ``race_s``."""
    scale = {"ms": 1e3, "us": 1e6}[unit]
    ours_s, theirs_s = race_s([call, baseline[1]], rounds, warm_up, in_a_row)
    return Row.of(name, ours_s * scale, unit, (baseline[0], theirs_s * scale), goal=goal)
