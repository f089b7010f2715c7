"""The companion as a user starts it, and what a flight of it leaves."""

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec

from companion.flight import FlightOrder, fly_plan
from companion.flightlog import FlightLog
from companion.logfolder import LOG_NAME, SUMMARY_NAME
from companion.memory import MODEL_NAME
from companion.plan import Plan, load_plan
from companion.summary import Summary
from flightcard.errors import NotMetError

LIMIT_S = 110.0
"""Wall time, for whatever is waited for; compiling for a cold cache takes most of it."""


class Flown(NamedTuple):
    """A flight that is over, and the folder it left."""

    summary: Summary
    log_dir: Path
    plan: Plan

    @property
    def log(self) -> FlightLog:
        return FlightLog(self.log_dir / LOG_NAME)

    def bytes_of(self, name: str) -> bytes:
        return (self.log_dir / name).read_bytes()


def fly_in_lockstep(plan_path: Path, overrides: tuple[str, ...], log_dir: Path) -> Flown:
    """``companion fly PLAN --vehicle lockstep --set ...`` in this process."""
    plan = load_plan(plan_path, overrides)
    order = FlightOrder(plan=plan, plan_path=plan_path, vehicle="lockstep", log_dir=log_dir)
    summary = asyncio.run(fly_plan(order, lambda step, pipeline: None))
    return Flown(summary, log_dir, plan)


class CompanionProcess:
    """``companion fly`` as a process; ``words`` are further ones of its command line."""

    def __init__(
        self,
        plan_path: Path,
        log_dir: Path,
        vehicle: str,
        words: tuple[str, ...] = (),
        preexec: Callable[[], None] | None = None,
    ) -> None:
        self.parent_dir = log_dir
        command = ("fly", str(plan_path), "--vehicle", vehicle, "--speed", "10")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "companion", *command, "--log-dir", str(log_dir), *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=preexec,
        )

    def wait_until_flying(self, flown_s: int = 0) -> None:
        """Until the progress line of this time, of those that come every 30 s."""
        assert self.process.stderr is not None
        passed: list[str] = []
        while not (passed and passed[-1].startswith(f"{flown_s:5d} s  ")):
            passed.append(self.process.stderr.readline())
            if not passed[-1]:
                raise NotMetError(f"the companion ended before {flown_s} s of flight: {passed}")

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    def kill_simulator(self) -> None:
        pid = self.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        os.kill(int(children[0]), signal.SIGKILL)

    def wait(self) -> tuple[int, list[str]]:
        """(exit code, lines on stderr since last read)."""
        _, error = self.process.communicate(timeout=LIMIT_S)
        if "Traceback" in error:
            raise NotMetError(f"the companion ended in a traceback:\n{error}")
        return self.process.returncode, error.splitlines()

    def leaves(self) -> tuple[dict[str, object], FlightLog]:
        """(summary, log) of the one flight in the folder."""
        (log_dir,) = self.parent_dir.iterdir()
        if not (log_dir / MODEL_NAME).stat().st_size:
            raise NotMetError(f"{log_dir / MODEL_NAME}: empty")
        summary = msgspec.json.decode((log_dir / SUMMARY_NAME).read_bytes())
        return summary, FlightLog(log_dir / LOG_NAME)

    def end(self) -> None:
        """Kills what is left of it."""
        with self.process as process:
            process.kill()
