"""How a vehicle follows the level velocity that it is asked for, as its flights tell.

python -m tools.response LOGS ...

Fits the model by which wind is told (the plan's ``push_back.response_*``): a delay and a
second-order lag. Prints the plan's lines, and how far the model is off: ``push_back.above_norm``
times the forward speed must be more than that. To be fitted to flights without wind.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from companion.flightlog import Topic
from companion.flying.push_back import LONGEST_GAP_NS, PushBackSettings, Response
from companion.kernel.errors import PlanError
from companion.kernel.frames import ned_from_hfrd
from tools.drawing import run
from tools.flown import FlownFlight, find_logs

LEAST_CHANGES = 5
"""Of what was asked: a vehicle that only hovered tells nothing."""
CHANGE_M_S = 0.1
FIELDS = ("response_delay_s", "response_rad_s", "response_damping")
SPREAD = (0.1, 1.5, 0.3)
"""By how much the search begins to vary each."""
LIMITS = ((0.0, 1.0), (0.5, 10.0), (0.1, 2.0))


class Following(NamedTuple):
    """What was asked of a vehicle, and what it did: a row per frame, (n, 2) NED, m/s."""

    stamp_ns: NDArray[np.int64]
    asked_m_s: NDArray[np.float64]
    flown_m_s: NDArray[np.float64]


def following_of(flight: FlownFlight) -> Following:
    """By the autopilot's own estimate."""
    setpoint, telemetry = flight.log.tables(Topic.SETPOINT, Topic.TELEMETRY)
    told_ns = flight.log.log_times_ns(Topic.TELEMETRY)
    stamp_ns, ours, theirs = np.intersect1d(setpoint["stamp_ns"], told_ns, return_indices=True)
    level = setpoint["velocity_hfrd_m_s"][ours, :2].tolist()
    yaws_rad = telemetry["yaw_rad"][theirs].tolist()
    turned = [ned_from_hfrd(v[0], v[1], yaw) for v, yaw in zip(level, yaws_rad, strict=True)]
    asked = np.array(turned, dtype=np.float64).reshape(-1, 2)
    flown = telemetry["velocity_ned_m_s"][theirs, :2]
    known = np.isfinite(asked).all(axis=1) & np.isfinite(flown).all(axis=1)
    return Following(stamp_ns[known], asked[known], flown[known])


def errors_m_s(following: Following, settings: PushBackSettings) -> NDArray[np.float64]:
    """Of the model's velocity, (n,)."""
    model, expected = Response(settings), np.empty_like(following.flown_m_s)
    before_ns = -LONGEST_GAP_NS
    for number, stamp_ns in enumerate(following.stamp_ns.tolist()):
        if stamp_ns - before_ns > LONGEST_GAP_NS:
            north, east = following.flown_m_s[number].tolist()
            model.restart(stamp_ns, (north, east))
        expected[number] = model.velocity_at(stamp_ns)
        north, east = following.asked_m_s[number].tolist()
        model.ask(stamp_ns, (north, east))
        before_ns = stamp_ns
    off_m_s: NDArray[np.float64] = following.flown_m_s - expected
    return np.asarray(np.linalg.norm(off_m_s, axis=1))


def fit(flights: Sequence[Following]) -> PushBackSettings:
    """Least squares. Raises PlanError where hardly anything was asked of the vehicle."""
    steps = [np.linalg.norm(np.diff(f.asked_m_s, axis=0), axis=1) > CHANGE_M_S for f in flights]
    if sum(int(step.sum()) for step in steps) < LEAST_CHANGES:
        raise PlanError(f"the velocity that was asked for changed less than {LEAST_CHANGES} times")

    def cost(values: NDArray[np.float64]) -> float:
        settings = _settings(values)
        return float(np.mean(np.concatenate([errors_m_s(f, settings) for f in flights]) ** 2))

    default = PushBackSettings()
    begin = np.array([getattr(default, field) for field in FIELDS])
    simplex = np.vstack([begin, begin + np.diag(SPREAD)])
    found = minimize(
        cost, begin, method="Nelder-Mead", bounds=LIMITS,
        options={"initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-7},
    )  # fmt: skip
    return _settings(found.x)


def _settings(values: NDArray[np.float64]) -> PushBackSettings:
    fields = dict(zip(FIELDS, values.tolist(), strict=True))
    return msgspec.structs.replace(PushBackSettings(), **fields)


def lines_of(flights: Sequence[Following]) -> Iterator[str]:
    """The plan's table and the errors, beside those of the defaults."""
    settings = fit(flights)
    yield "[push_back]"
    for field in FIELDS:
        yield f"{field} = {getattr(settings, field):.2f}"
    for name, model in (("this model", settings), ("the defaults", PushBackSettings())):
        errors = np.concatenate([errors_m_s(flight, model) for flight in flights])
        usual, most = np.quantile(errors, [0.99, 1.0])
        yield (
            f"# error of {name}: {np.sqrt(np.mean(errors**2)):.3f} m/s RMS,"
            f" {usual:.2f} in 99 %, {most:.2f} at most, of {len(errors)} frames"
        )


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.response",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", type=Path, nargs="+", help="flights, or folders that hold them")
    args = parser.parse_args(argv)

    def work() -> Iterator[str]:
        yield from lines_of([following_of(FlownFlight(path)) for path in find_logs(args.logs)])

    return run("response", work)


if __name__ == "__main__":
    sys.exit(main())
