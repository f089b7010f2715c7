"""Flights for the tools: invented ones, whose figures are known, and a short real one."""

import asyncio
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest

from companion.flight import FlightOrder, fly_plan
from companion.flightlog import FlightLogWriter, FlightMetadata, Topic
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import (
    BehaviourState,
    Cue,
    Decision,
    MocapPose,
    Percept,
    Phase,
    Telemetry,
)
from companion.plan import load_plan

PLAN = Path(__file__).parents[2] / "flightplans" / "room1.toml"
PERIOD_NS = 100_000_000
EYE = Intrinsics(focal_x_px=117.0, focal_y_px=117.0, centre_x_px=63.5, centre_y_px=47.5)
CALIBRATION = StereoCalibration(width_px=128, height_px=96, left=EYE, right=EYE, baseline_m=0.06)


class Moment(NamedTuple):
    """One frame of an invented flight."""

    phase: Phase = Phase.TEST
    cue: Cue = Cue.MONO
    state: BehaviourState = BehaviourState.STRAIGHT
    stereo_px: float = 2.0
    mono_px: float = 2.0
    override: bool = False
    place_m: tuple[float, float] = (0.0, 0.0)
    collisions: int = 0


def _write_frame(log, stamp_ns, moment, truth):
    log.write(
        Topic.PERCEPT,
        Percept(
            stamp_ns=stamp_ns,
            stereo_px=moment.stereo_px,
            stereo_valid_norm=1.0,
            mono_px=moment.mono_px,
            mono_std_px=0.1,
        ),
    )
    mono = moment.cue is Cue.MONO
    log.write(
        Topic.DECISION,
        Decision(
            stamp_ns=stamp_ns,
            phase=moment.phase,
            cue=moment.cue,
            override=moment.override,
            disparity_px=moment.mono_px if mono else moment.stereo_px,
            threshold_px=3.5 if mono else 4.0,
            state=moment.state,
            overrides=0,
            turns=0,
            approaches=0,
        ),
    )
    place_ned_m = (*moment.place_m, -1.2)
    log.write(Topic.TELEMETRY, Telemetry(stamp_ns=stamp_ns, position_ned_m=place_ned_m))
    if truth:
        log.write(
            Topic.MOCAP,
            MocapPose(
                stamp_ns=stamp_ns,
                truth_position_ned_m=place_ned_m,
                truth_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
                truth_clearance_m=1.0,
                truth_collisions=moment.collisions,
            ),
        )


@pytest.fixture
def invent(tmp_path):
    """``invent(moments, name=..., scheme=..., truth=..., TABLE=...)``: the path of its log."""

    def write(moments, name="flight", scheme="training_wheels", truth=True, **tables):
        plan = {"room": "room1", "experiment": {"scheme": scheme}, **tables}
        folder = tmp_path / "logs" / name
        folder.mkdir(parents=True)
        path = folder / "flight.mcap"
        metadata = FlightMetadata(plan=plan, seed=1, version="0", calibration=CALIBRATION)
        with FlightLogWriter(path, metadata) as log:
            for number, moment in enumerate(moments):
                _write_frame(log, number * PERIOD_NS, moment, truth)
        return path

    return write


@pytest.fixture
def moment():
    """Makes a Moment of an invented flight."""
    return Moment


class RealFlight(NamedTuple):
    log_dir: Path
    summary: object

    @property
    def log_path(self):
        return self.log_dir / "flight.mcap"


@pytest.fixture(scope="session")
def real_flight(tmp_path_factory):
    """20 s in lockstep with images."""
    words = ["experiment.initial_s=10", "experiment.learning_s=5", "experiment.test_s=5"]
    plan = load_plan(PLAN, [*words, "log.images=stereo"])
    log_dir = tmp_path_factory.mktemp("real")
    order = FlightOrder(plan=plan, plan_path=PLAN, vehicle="lockstep", log_dir=log_dir)
    summary = asyncio.run(fly_plan(order, lambda step, pipeline: None))
    assert summary.outcome == "flown"
    return RealFlight(log_dir, msgspec.to_builtins(summary))
