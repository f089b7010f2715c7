"""Kills the companion with SIGKILL at random moments in flight, and looks at what is left.

Each flight begins with what the one before it left: every log must recover to within a second of
the kill, and every model must be readable, the newest or the one saved before it.
"""

import argparse
import asyncio
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion.flight import FlightOrder, fly_plan
from companion.flightlog import FlightLog, Topic
from companion.kernel.errors import CompanionError
from companion.logfolder import LOG_NAME
from companion.memory import MODEL_NAME, recall
from companion.plan import Plan, load_plan
from tools.drawing import run, save_table
from tools.kills.victim import kill_in_flight
from tools.logs.recover import RECOVERED_SUFFIX, recover

PLAN = Path(__file__).parents[2] / "flightplans" / "room1.toml"
SHORT = (
    "experiment.initial_s=8", "experiment.learning_s=16", "experiment.test_s=8",
    "log.model_period_s=1",
)  # fmt: skip
"""Half a minute, saving thirty times as often as usual: kills shall meet saves."""
MOST_LOST_S = 1.0
FIRST_NAME = "00"


class Kill(NamedTuple):
    """What was left of one flight."""

    number: int
    killed_s: float
    """After the first frame."""
    lost_s: float
    """From the last frame in the recovered log to the last one flown."""
    model: str
    """Of which flight, and whether it is the newest."""
    problem: str = ""

    @property
    def good(self) -> bool:
        return not self.problem and self.lost_s <= MOST_LOST_S


def main(argv: Sequence[str] | None = None) -> int:
    args = _parser().parse_args(argv)
    return run("kills", lambda: _work(args))


def _work(args: argparse.Namespace) -> Iterator[str]:
    plan = load_plan(args.plan, (*SHORT, *(args.set or ())), args.seed)
    args.out.mkdir(parents=True)
    _fly_the_first(plan, args.plan, args.out)
    kills = []
    for number in range(1, args.n + 1):
        kills.append(_kill(number, plan, args.plan, args.out))
        yield _line(kills[-1])
    yield f"{save_table(args.out / 'kills.csv', Kill._fields, kills)}"
    n_good = sum(kill.good for kill in kills)
    worst_s = max(kill.lost_s for kill in kills)
    n_previous = sum("previous" in kill.model for kill in kills)
    yield (
        f"{n_good} of {len(kills)} recovered; at most {worst_s:.2f} s of log lost; "
        f"{n_previous} models fell back to the save before"
    )
    if n_good < len(kills):
        raise CompanionError(f"{len(kills) - n_good} kills left something that does not recover")


def _fly_the_first(plan: Plan, plan_path: Path, out: Path) -> None:
    """In peace: the model that the next begins with."""
    summary = asyncio.run(
        fly_plan(_order(plan, plan_path, out / FIRST_NAME), lambda step, pipeline: None)
    )
    if summary.outcome != "flown":
        raise CompanionError(f"{plan_path}: flight {summary.outcome}: {summary.reason}")


def _order(plan: Plan, plan_path: Path, folder: Path) -> FlightOrder:
    folder.mkdir()
    model = None if folder.name == FIRST_NAME else folder.parent
    return FlightOrder(
        plan=plan, plan_path=plan_path, vehicle="lockstep", log_dir=folder, model=model
    )


def _kill(number: int, plan: Plan, plan_path: Path, out: Path) -> Kill:
    rng = np.random.default_rng([plan.seed, number])
    experiment = plan.experiment
    flight_s = experiment.initial_s + experiment.learning_s + experiment.test_s
    after_s = rng.uniform(0.0, flight_s - 1.0)
    order = _order(plan, plan_path, out / f"{number:02d}")
    killed_ns = kill_in_flight(order, after_s, rng)
    try:
        lost_s = (killed_ns - _last_frame_ns(order.log_dir / LOG_NAME)) * 1e-9
        log = FlightLog(out / FIRST_NAME / LOG_NAME)
        assert log.metadata.calibration is not None
        found = recall(out, log.metadata.calibration).path
    except CompanionError as error:
        return Kill(number, after_s, float("nan"), "", str(error))
    model = f"{found.parent.name} {'newest' if found.name == MODEL_NAME else 'previous'}"
    return Kill(number, after_s, max(0.0, lost_s), model)


def _last_frame_ns(path: Path) -> int:
    """In the log, after it was recovered."""
    whole = path.with_suffix(RECOVERED_SUFFIX)
    recover(path, whole)
    return int(FlightLog(whole).columns(Topic.PERCEPT)["stamp_ns"][-1])


def _line(kill: Kill) -> str:
    said = kill.problem or f"{kill.lost_s:.2f} s of log lost, model of flight {kill.model}"
    return f"{kill.number:3d}  killed at {kill.killed_s:5.2f} s: {said}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tools.kills", description=__doc__)
    parser.add_argument("--plan", type=Path, default=PLAN, help="default: room1, shortened")
    parser.add_argument("--n", type=int, default=50, help="kills; default: 50")
    parser.add_argument("--seed", type=int, default=1, help="of the flights and the moments")
    parser.add_argument("--set", nargs="+", metavar="KEY=VALUE", help="keys of the plan")
    parser.add_argument("--out", type=Path, default=Path("logs/kills"), help="a new folder")
    return parser


if __name__ == "__main__":
    sys.exit(main())
