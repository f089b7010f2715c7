"""How well one eye knew each zone that a flight stayed in, in the order of the stays.

python -m tools.stays LOGS ...

A line per stay (the plan's ``behaviour.zone``; short ones, as in front of a door, count to the one
before): mono's error against stereo's λ before the frame was learned from, in its first half minute
and after that, the share of the time that mono was trusted, and the overrides.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.kernel.errors import PlanError
from tools.drawing import run
from tools.flown import FlownFlight, find_logs

SHORTEST_S = 60.0
FIRST_S = 30.0
HEADER = (
    f"{'flight':36} {'from':>6} {'to':>6}  {'|error|, px: first':>18} {'then':>6}"
    f"  {'trusted':>8} {'novelty':>8} {'overrides':>9}"
)


class Stay(NamedTuple):
    """One zone, from its time to the next one's; NaN where nothing was estimated."""

    from_s: float
    to_s: float
    first_error_px: float
    """Mean absolute error of the first FIRST_S; ``then_error_px`` of what follows."""
    then_error_px: float
    trusted_norm: float
    novelty: float
    overrides: int


def stays_of(flight: FlownFlight) -> list[Stay]:
    """Raises PlanError for a flight whose plan has no zones."""
    begins_s = sorted(zone.from_s for zone in flight.plan.behaviour.zone)
    if not begins_s:
        raise PlanError(f"{flight.path}: the plan has no behaviour.zone")
    ends_s = [*begins_s[1:], float(flight.time_s[-1])]
    long = [begin for begin, end in zip(begins_s, ends_s, strict=True) if end - begin >= SHORTEST_S]
    bounds_s = [*long, float(flight.time_s[-1])]
    return [_stay(flight, *span) for span in pairwise(bounds_s)]


def _stay(flight: FlownFlight, from_s: float, to_s: float) -> Stay:
    here = (flight.time_s >= from_s) & (flight.time_s < to_s)
    first = here & (flight.time_s < from_s + FIRST_S)
    error_px = np.abs(flight.percept["mono_px"] - flight.percept["stereo_px"])
    override = flight.decision["override"].astype(bool)
    return Stay(
        from_s,
        to_s,
        _mean(error_px[first]),
        _mean(error_px[here & ~first]),
        float(np.mean(flight.decision["trust"][here] == "trusted")),
        _mean(flight.percept["mono_novelty"][here]),
        int(np.count_nonzero(override[1:] & ~override[:-1] & here[1:])),
    )


def _mean(values: NDArray[np.float64]) -> float:
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else np.nan


def lines_of(flight: FlownFlight) -> Iterator[str]:
    """The table's lines of one flight."""
    for stay in stays_of(flight):
        yield (
            f"{flight.name[:36]:36} {stay.from_s:6.0f} {stay.to_s:6.0f}"
            f"  {stay.first_error_px:18.2f} {stay.then_error_px:6.2f}"
            f"  {stay.trusted_norm:8.0%} {stay.novelty:8.2f} {stay.overrides:9d}"
        )


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.stays",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", type=Path, nargs="+", help="flights, or folders that hold them")
    args = parser.parse_args(argv)

    def work() -> Iterator[str]:
        yield HEADER
        for path in find_logs(args.logs):
            yield from lines_of(FlownFlight(path))

    return run("stays", work)


if __name__ == "__main__":
    sys.exit(main())
