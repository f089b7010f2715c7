"""MAVSDK's mocap and failure plugins, as their users have them, against ``sitl run``."""

import json
import math
import subprocess
import sys
from pathlib import Path
from queue import Queue

import pytest
from mavsdk.plugins.failure import Failure, FailureError, FailureResult, FailureType, FailureUnit
from mavsdk.plugins.mocap import (
    AngleBody,
    AngularVelocityBody,
    AttitudePositionMocap,
    Covariance,
    Mocap,
    Odometry,
    PositionBody,
    Quaternion,
    SpeedBody,
    VisionPositionEstimate,
)
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

from sitl.process import reserved_mavlink_port

ROOM = str(Path(__file__).parents[2] / "flightplans" / "rooms" / "room1.toml")
DRIFT = json.dumps({"estimator_drift_ned_m_s": [0.2, 0.0, 0.0]})
LIMIT_S = 20.0
UPDATES = 45
"""Positions that are waited for: 1.5 s of the vehicle's time."""
NAN = math.nan
HERE, UPRIGHT, UNKNOWN = PositionBody(0.0, 0.0, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0), [NAN] * 21


@pytest.fixture(scope="module")
def system():
    """MAVSDK's view of a vehicle that stands in a room and believes that it drifts to the north."""
    from mavsdk import ComponentType, Configuration, Mavsdk

    with reserved_mavlink_port() as port:
        words = ["--mavlink", f"udpout://127.0.0.1:{port}", "--camera", "tcp://127.0.0.1:0"]
        words += ["--fault", DRIFT, "--speed", "3", "--until-stdin-closes"]
        with subprocess.Popen(
            [sys.executable, "-m", "sitl", "run", ROOM, *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as process:
            process.stdout.readline()
            client = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
            client.add_any_connection(f"udpin://127.0.0.1:{port}")
            yield client.first_autopilot(LIMIT_S)
            client.destroy()
            process.stdin.close()
            assert process.wait(LIMIT_S) == 0


def vision_position(mocap):
    angles, covariance = AngleBody(0.0, 0.0, 0.0), Covariance(UNKNOWN)
    mocap.set_vision_position_estimate(VisionPositionEstimate(0, HERE, angles, covariance, 0))


def attitude_position(mocap):
    covariance = Covariance(UNKNOWN)
    mocap.set_attitude_position_mocap(AttitudePositionMocap(0, UPRIGHT, HERE, covariance))


def odometry(mocap):
    frame, kind = Odometry.MavFrame.MOCAP_NED, Odometry.MavEstimatorType.MOCAP
    speeds = SpeedBody(NAN, NAN, NAN), AngularVelocityBody(NAN, NAN, NAN)
    covariances = Covariance(UNKNOWN), Covariance(UNKNOWN)
    mocap.set_odometry(Odometry(0, frame, HERE, UPRIGHT, *speeds, *covariances, 0, kind, 0))


@pytest.fixture(scope="module")
def north_m(system):
    """``north_m(each)``: where the vehicle believes to be after UPDATES calls of ``each``."""
    telemetry, positions = Telemetry(system), Queue()
    telemetry.subscribe_position_velocity_ned(lambda update, _: positions.put(update.position))

    def wait(each=lambda: None):
        while not positions.empty():
            positions.get()
        for _ in range(UPDATES):
            each()
            position = positions.get(timeout=LIMIT_S)
        return position.north_m

    yield wait
    telemetry.destroy()


def test_without_mocap_the_drift_goes_on(north_m):
    before_m = north_m()
    assert north_m() - before_m > 0.15


@pytest.mark.parametrize("send", [vision_position, attitude_position, odometry])
def test_mocap_bounds_the_drift(system, north_m, send):
    mocap = Mocap(system)
    assert abs(north_m(lambda: send(mocap))) < 0.1
    mocap.destroy()


def test_failures_are_injected_when_the_parameter_allows_it(system):
    """MAVSDK reads SYS_FAILURE_EN once for each plugin object."""
    parameters = Param(system)

    def inject(unit, kind):
        failure = Failure(system)
        try:
            return failure.inject(unit, kind, 0)
        except FailureError as error:
            return error.result
        finally:
            failure.destroy()

    gps = FailureUnit.SENSOR_GPS, FailureType.OFF
    assert inject(*gps) in {FailureResult.DISABLED, FailureResult.DENIED}
    parameters.set_param_int("SYS_FAILURE_EN", 1)
    assert inject(*gps) is FailureResult.SUCCESS
    assert inject(FailureUnit.SENSOR_GYRO, FailureType.OFF) is FailureResult.UNSUPPORTED
    parameters.destroy()
