"""What ends a flight early, and what it leaves: one line, an exit code, a readable log."""

import asyncio
import itertools
import os
import resource
import signal
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.flight import FlightOrder, fly_plan
from companion.flightlog import FlightLog
from companion.kernel.errors import CompanionError, RecordingError
from companion.plan import Plan, load_plan

PLAN = Path(__file__).parents[2] / "flightplans" / "office.toml"


@pytest.mark.parametrize(
    ("vehicle", "number"), [("lockstep", signal.SIGINT), ("sitl", signal.SIGTERM)]
)
def test_a_signal_lands_the_vehicle(start_companion, vehicle, number):
    companion = start_companion(vehicle)
    companion.wait_until_flying()
    companion.signal(number)
    code, lines = companion.wait()
    assert code == 1
    assert lines[-1] == f"companion: flight aborted: stopped by {number.name}"
    summary, log = companion.leaves()
    assert (summary["outcome"], summary["reason"]) == ("aborted", f"stopped by {number.name}")
    assert not log.truncated
    assert log.topics()["/percept"] == summary["frames"] > 0
    assert abs(log.columns("/mocap")["truth_position_ned_m"][-1, 2]) < 0.15  # on the ground


def test_a_killed_simulator_ends_the_flight(start_companion):
    companion = start_companion("sitl")
    companion.wait_until_flying()
    companion.kill_simulator()
    code, lines = companion.wait()
    assert code == 1
    assert lines[-1].startswith("companion: flight failed: the simulator died in flight")
    assert not any(line.startswith("companion: ") for line in lines[:-1])
    summary, log = companion.leaves()
    assert summary["outcome"] == "failed"
    assert summary["sim_s"] > 0
    assert not log.truncated
    assert log.topics()["/percept"] == summary["frames"] > 0


def test_a_killed_companion_leaves_a_readable_log_and_says_so(start_companion):
    companion = start_companion("lockstep")
    companion.wait_until_flying(30)
    companion.signal(signal.SIGKILL)
    assert companion.wait()[0] == -signal.SIGKILL
    (log_dir,) = companion.parent_dir.iterdir()
    summary = msgspec.json.decode((log_dir / "summary.json").read_bytes())
    assert summary["reason"] == "the companion was killed in flight"
    log = FlightLog(log_dir / "flight.mcap")
    assert log.truncated
    assert log.topics()["/percept"] > 250


def test_a_disk_that_is_full_ends_the_flight_but_not_the_log(start_companion):
    limit_bytes = 200_000  # a file that may not grow fails as one on a full disk does

    def limit_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))

    companion = start_companion("lockstep", preexec=limit_files)
    code, lines = companion.wait()
    assert code == 1
    assert lines[-1].startswith("companion: flight failed: ")
    assert lines[-1].endswith("flight.mcap: cannot be written: File too large")
    summary, log = companion.leaves()
    assert summary["outcome"] == "failed"
    assert log.truncated
    assert log.topics()["/percept"] > 50


def test_a_signal_at_the_very_end_does_not_keep_it_from_landing(tmp_path):
    durations = ("initial_s=2", "learning_s=0", "test_s=0")
    plan = load_plan(PLAN, [f"experiment.{text}" for text in durations])
    order = FlightOrder(plan=plan, plan_path=PLAN, vehicle="lockstep", log_dir=tmp_path)
    frames = itertools.count(1)

    def stop_at_the_last_frame(step, pipeline):
        if next(frames) == 20:
            os.kill(os.getpid(), signal.SIGTERM)

    summary = asyncio.run(fly_plan(order, stop_at_the_last_frame))
    assert (summary.outcome, summary.frames) == ("aborted", 20)
    log = FlightLog(tmp_path / "flight.mcap")
    assert abs(log.columns("/mocap")["truth_position_ned_m"][-1, 2]) < 0.15


def test_a_learner_that_fails_brings_the_vehicle_down(tmp_path, caplog):
    plan = load_plan(PLAN, ["experiment.initial_s=60"])
    order = FlightOrder(plan=plan, plan_path=PLAN, vehicle="lockstep", log_dir=tmp_path)

    def fail(features):
        raise np.linalg.LinAlgError("singular matrix")

    def spoil(step, pipeline):
        pipeline.learner.predict = fail

    summary = asyncio.run(fly_plan(order, spoil))
    assert (summary.outcome, summary.frames) == ("failed", 1)
    assert summary.reason == "perceiving and deciding failed: LinAlgError: singular matrix"
    assert "Traceback" in caplog.text  # for whoever has to mend it
    log = FlightLog(tmp_path / "flight.mcap")
    assert abs(log.columns("/mocap")["truth_position_ned_m"][-1, 2]) < 0.15


def order_without_camera(log_dir):
    log_dir.mkdir()
    return FlightOrder(
        plan=Plan(),
        plan_path=Path("plan.toml"),
        vehicle="udpin://127.0.0.1:0",
        camera=f"ipc://{log_dir}/nobody",
        log_dir=log_dir,
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_before_take_off_leaves_nothing(tmp_path, number):
    order = order_without_camera(tmp_path / "flight")

    async def run():
        asyncio.get_running_loop().call_later(0.1, os.kill, os.getpid(), number)
        await fly_plan(order, lambda step, pipeline: None)

    with pytest.raises(CompanionError, match=f"stopped by {number.name} before take-off"):
        asyncio.run(run())
    assert not order.log_dir.exists()


def test_a_disk_that_is_full_from_the_start_stops_before_take_off(tmp_path):
    plan = load_plan(PLAN)
    log_dir = tmp_path / "flight"
    log_dir.mkdir()
    (log_dir / "flight.mcap").symlink_to("/dev/full")
    order = FlightOrder(plan=plan, plan_path=PLAN, vehicle="lockstep", log_dir=log_dir)
    with pytest.raises(RecordingError, match=r"flight\.mcap: cannot be written: No space left"):
        asyncio.run(fly_plan(order, lambda step, pipeline: None))
    assert not log_dir.exists()
