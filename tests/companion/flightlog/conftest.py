"""What a flight writes to its log."""

import math

import pytest

from companion.flightlog import FlightLogWriter, FlightMetadata, Topic
from companion.health.words import PLACES
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import (
    BehaviourState,
    Cue,
    Decision,
    Drift,
    Event,
    Health,
    MocapPose,
    MonoMap,
    Percept,
    Phase,
    Setpoint,
    Telemetry,
    TrustFigures,
    TrustStatus,
)

NAN = math.nan
EYE = Intrinsics(100.0, 100.0, 64.0, 48.0)
META = FlightMetadata(
    plan={"seed": 7, "camera": {"rate_hz": 10.0}},
    seed=7,
    version="0.1.0",
    calibration=StereoCalibration(128, 96, EYE, EYE, 0.06),
)
STEP_NS = 100_000_000


def records_of(n):
    """``n`` frames' worth of every record type of a flight."""
    for stamp_ns in range(0, n * STEP_NS, STEP_NS):
        yield Topic.TELEMETRY, Telemetry(stamp_ns=stamp_ns, yaw_rad=0.25, armed=True)
        yield (
            Topic.PERCEPT,
            Percept(
                stamp_ns=stamp_ns,
                stereo_px=stamp_ns * 1e-9,
                stereo_valid_norm=0.5,
                mono_px=NAN,
                mono_std_px=NAN,
            ),
        )
        yield (
            Topic.DECISION,
            Decision(
                stamp_ns=stamp_ns,
                phase=Phase.LEARNING,
                cue=Cue.MONO,
                override=False,
                disparity_px=3.5,
                threshold_px=8.0,
                state=BehaviourState.STRAIGHT,
                overrides=0,
                turns=2,
                approaches=3,
            ),
        )
        yield Topic.SETPOINT, Setpoint(stamp_ns=stamp_ns, velocity_hfrd_m_s=(0.5, 0.0, -0.1))
        yield (
            Topic.MOCAP,
            MocapPose(
                stamp_ns=stamp_ns,
                truth_position_ned_m=(1.0, 2.0, -3.0),
                truth_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
                truth_clearance_m=0.8,
                truth_collisions=0,
            ),
        )
    yield Topic.EVENT, Event(stamp_ns=n * STEP_NS, severity="info", text="done")
    yield Topic.HEALTH, an_eye_is_black(n * STEP_NS)
    yield Topic.TRUST, TrustFigures(stamp_ns=n * STEP_NS, status=TrustStatus.LEARNING, auc=0.5)
    yield (
        Topic.DRIFT,
        Drift(
            stamp_ns=n * STEP_NS,
            velocity_ned_m_s=(0.2, -0.1),
            scatter_m_s=0.02,
            measurements=15,
            named=True,
            walked_ned_m=(1.0, -0.5),
        ),
    )
    yield Topic.MAP, MonoMap(stamp_ns=n * STEP_NS, columns=2, disparity_px=(1.5, NAN))


def an_eye_is_black(stamp_ns):
    names = [f"{place}_{what}" for place in PLACES for what in ("fault", "evidence")]
    said = dict.fromkeys(names, "") | {"left_fault": "black", "left_evidence": "all of it"}
    return Health(stamp_ns=stamp_ns, stereo=False, left=False, right=True, **said)


def write(path, n=30):
    with FlightLogWriter(path, META) as log:
        for topic, record in records_of(n):
            log.write(topic, record)
    return path


@pytest.fixture(scope="session")
def metadata():
    return META


@pytest.fixture(scope="session")
def records():
    """``records(n)``: topics and records of a flight of ``n`` frames at 10 Hz."""
    return records_of


@pytest.fixture(scope="session")
def write_flight():
    """``write_flight(path, n=30)``: a log of those records; returns the path."""
    return write


@pytest.fixture(scope="session")
def whole_log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("whole") / "flight.mcap", 60)
