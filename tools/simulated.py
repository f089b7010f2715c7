"""The big simulated recordings of the learning lab: plans flown in lockstep, with images."""

import asyncio
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from companion.flight import FlightOrder, fly_plan
from companion.kernel.errors import SimulatorError
from companion.logfolder import LOG_NAME
from companion.plan import load_plan

PLANS = Path(__file__).parents[1] / "flightplans"
SIMULATED = ("room1", "room2", "office", "corridor")


def fly_with_images(plan_path: Path, words: Sequence[str], log_dir: Path) -> Path:
    """The log of the plan's flight. Raises CompanionError."""
    plan = load_plan(plan_path, [*words, "log.images=stereo"])
    order = FlightOrder(plan=plan, plan_path=plan_path, vehicle="lockstep", log_dir=log_dir)
    summary = asyncio.run(fly_plan(order, lambda step, pipeline: None))
    if summary.outcome != "flown":
        raise SimulatorError(f"{plan_path}: flight {summary.outcome}: {summary.reason}")
    return log_dir / LOG_NAME


def missing_logs(folder: Path, words: Sequence[str]) -> Iterator[tuple[str, Path]]:
    """(name, log) of every simulated recording that ``folder`` does not hold yet.

    The log is gone when the next one is asked for.
    """
    for name in SIMULATED:
        if (folder / name).exists():
            continue
        with TemporaryDirectory() as log_dir:
            yield name, fly_with_images(PLANS / f"{name}.toml", words, Path(log_dir))
