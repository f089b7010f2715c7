"""Flights: in this process on simulated time, or as a user starts them at the command line."""

import asyncio
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest

from companion.flight import FlightOrder, fly_plan
from companion.flightlog import FlightLog
from companion.plan import Plan, load_plan
from companion.summary import Summary

PLAN = Path(__file__).parents[2] / "flightplans" / "office.toml"
LIMIT_S = 110.0
"""Wall time, for whatever a test waits for; compiling for a cold cache takes most of it."""


class Flown(NamedTuple):
    summary: Summary
    log_dir: Path
    plan: Plan

    @property
    def log(self):
        return FlightLog(self.log_dir / "flight.mcap")

    def bytes_of(self, name):
        return (self.log_dir / name).read_bytes()


@pytest.fixture(scope="session")
def fly_lockstep(tmp_path_factory):
    """``fly_lockstep("experiment.scheme=dagger", ...)``: a flight with these overrides."""

    def fly(*overrides):
        plan = load_plan(PLAN, overrides)
        log_dir = tmp_path_factory.mktemp("flight")
        order = FlightOrder(plan=plan, plan_path=PLAN, vehicle="lockstep", log_dir=log_dir)
        summary = asyncio.run(fly_plan(order, lambda step, pipeline: None))
        return Flown(summary, log_dir, plan)

    return fly


class Companion:
    """``companion fly`` as a process, on a flight that is far too long to end by itself."""

    def __init__(self, log_dir, vehicle, *words, preexec=None):
        self.parent_dir = log_dir
        command = ("fly", str(PLAN), "--vehicle", vehicle, "--speed", "10")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "companion", *command, "--log-dir", str(log_dir), *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=preexec,
        )

    def wait_until_flying(self, flown_s=0):
        """Until the progress line of this time, of those that come every 30 s."""
        passed = []
        while not (passed and passed[-1].startswith(f"{flown_s:5d} s  ")):
            passed.append(self.process.stderr.readline())
            assert passed[-1], passed  # it ended

    def signal(self, number):
        self.process.send_signal(number)

    def kill_simulator(self):
        pid = self.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        os.kill(int(children[0]), signal.SIGKILL)

    def wait(self):
        """(exit code, lines on stderr since last read)."""
        _, error = self.process.communicate(timeout=LIMIT_S)
        assert "Traceback" not in error
        return self.process.returncode, error.splitlines()

    def leaves(self):
        """(summary, log) of the one flight in the folder."""
        (log_dir,) = self.parent_dir.iterdir()
        summary = msgspec.json.decode((log_dir / "summary.json").read_bytes())
        assert (log_dir / "model.npz").stat().st_size > 0
        return summary, FlightLog(log_dir / "flight.mcap")


@pytest.fixture
def start_companion(tmp_path):
    """Starts ``companion fly``; whatever is left of it at the end of the test is killed."""
    started = []

    def start(vehicle, *words, preexec=None):
        started.append(Companion(tmp_path / "logs", vehicle, *words, preexec=preexec))
        return started[-1]

    yield start
    for companion in started:
        with companion.process as process:
            process.kill()
