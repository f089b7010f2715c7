"""External vision: planted drift is found and mended."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.kernel.frames import ned_from_hfrd, quaternion_from_euler
from companion.kernel.messages import FlightMode
from sitl.autopilot.estimation.axis_filter import AxisFilter

HZ = 30


def test_without_vision_the_planted_drift_runs_away(drifting, drift_m_s):
    drifting.flight.run(10.0)
    assert drifting.error_m()[0] == pytest.approx(drift_m_s * 10.0, abs=0.3)


def test_with_vision_it_is_bounded_and_the_velocity_is_right(drifting):
    drifting.run(10.0)
    assert drifting.error_m()[0] < 0.05
    assert drifting.flight.autopilot.estimate.velocity_ned_m_s[0] == pytest.approx(0.0, abs=0.06)
    quality = drifting.flight.autopilot.quality
    assert quality.absolute
    assert quality.level_deviation_m < 0.1


def test_a_vehicle_in_the_air_stays_in_place_only_with_vision(make_flight, make_mocap, drift_m_s):
    places = []
    for seeing in (False, True):
        mocap = make_mocap(make_flight())
        mocap.run(3.0)
        mocap.flight.take_off()
        mocap.flight.autopilot.set_drift((drift_m_s, 0.0, 0.0))
        mocap.run(20.0, None if seeing else lambda: None)
        home_m = mocap.flight.world.room_from_home_m
        places.append(np.subtract(mocap.flight.world.truth.position_ned_m, home_m)[0])
    blind_m, seeing_m = places
    assert blind_m == pytest.approx(-drift_m_s * 20.0, rel=0.2)
    assert abs(seeing_m) < 0.1


@pytest.mark.parametrize(
    ("bits", "level", "yaw"),
    [(0, False, False), (1, True, False), (4, False, False), (9, True, True)],
)
def test_ev_ctrl_chooses_what_is_used(drifting, bits, level, yaw):
    autopilot = drifting.flight.autopilot
    autopilot.set_parameter("EKF2_EV_CTRL", bits)
    autopilot.set_parameter("SYS_HAS_MAG", 0)  # so that the heading turns away by itself
    drifting.run(10.0)
    assert (drifting.error_m()[0] < 0.05) is level
    assert (abs(autopilot.estimate.yaw_rad) < math.radians(0.5)) is yaw


@pytest.mark.parametrize(("control", "least_m", "most_m"), [(7, 0.0, 0.7), (0, 2.5, 3.5)])
def test_satellites_bound_the_drift_if_gps_ctrl_wants_them(drifting, control, least_m, most_m):
    drifting.flight.autopilot.set_parameter("EKF2_GPS_CTRL", control)
    drifting.flight.autopilot.set_parameter("SYS_HAS_GPS", 1)
    drifting.flight.run(15.0)
    assert least_m <= drifting.error_m()[0] < most_m


def test_vision_goes_before_satellites(drifting):
    drifting.flight.autopilot.set_parameter("SYS_HAS_GPS", 1)
    drifting.run(10.0)
    assert drifting.error_m()[0] < 0.05


def test_velocity_alone_stops_the_drift_but_not_what_it_was(drifting):
    def send():
        drifting.send(position_m=(math.nan,) * 3, attitude=None, velocity_m_s=(0.0, 0.0, 0.0))

    drifting.flight.run(5.0)
    drifting.run(3.0, send)
    before_m = drifting.error_m()[0]
    assert before_m > 0.9
    drifting.run(5.0, send)
    assert drifting.error_m()[0] - before_m < 0.3


@pytest.mark.parametrize("delay_ms", [0.0, 150.0])
def test_late_samples_are_compared_with_what_was_then(make_flight, make_mocap, delay_ms):
    """At 1 m/s samples that are 150 ms old are 0.15 m behind, unless that is known."""
    mocap = make_mocap(make_flight(), noise_m=0.0)
    mocap.run(3.0)
    mocap.flight.take_off()
    mocap.flight.autopilot.set_parameter("EKF2_EV_DELAY", delay_ms)
    mocap.flight.autopilot.set_parameter("EKF2_EVP_NOISE", 0.01)
    mocap.flight.send(north_m_s=1.0)
    mocap.flight.autopilot.set_mode(FlightMode.OFFBOARD)
    old = []

    def send():
        mocap.flight.send(north_m_s=1.0)
        old.append(mocap.look(stamp_s=math.nan))
        if len(old) > 4:
            mocap.flight.autopilot.take_vision(old[-5])

    mocap.run(6.0, send)
    level_m = mocap.error_m()[0]
    assert level_m < 0.03 if delay_ms else level_m > 0.08


def test_a_stamp_of_the_vehicles_clock_says_how_old_a_sample_is(make_flight, make_mocap):
    mocap = make_mocap(make_flight(), noise_m=0.0)
    mocap.run(3.0)
    mocap.flight.take_off()
    mocap.flight.send(north_m_s=1.0)
    mocap.flight.autopilot.set_mode(FlightMode.OFFBOARD)
    old = []

    def send():
        mocap.flight.send(north_m_s=1.0)
        old.append(mocap.look())
        if len(old) > 4:
            mocap.flight.autopilot.take_vision(old[-5])

    mocap.run(6.0, send)
    assert mocap.error_m()[0] < 0.03


def test_a_frame_without_north_is_turned_as_it_first_appears(drifting):
    turn_rad = math.radians(40.0)

    def send():
        north, east, down = drifting.look().position_m
        yaw_rad = drifting.flight.world.truth.euler_rad[2]
        drifting.send(
            position_m=(*ned_from_hfrd(north, east, -turn_rad), down),
            attitude=quaternion_from_euler(0.0, 0.0, yaw_rad - turn_rad),
            north_known=False,
        )

    drifting.run(10.0, send)
    assert drifting.error_m()[0] < 0.05
    assert abs(drifting.flight.autopilot.estimate.yaw_rad) < math.radians(0.5)


@settings(max_examples=30)
@given(st.floats(-5.0, 5.0), st.floats(-0.3, 0.3), st.floats(0.0, 0.2), st.integers(0, 2**32 - 1))
def test_the_filter_finds_offset_and_rate_that_were_planted(offset, rate, lag_s, seed):
    rng, axis = np.random.default_rng(seed), AxisFilter(0.02, 10.0)
    axis.move(offset, 0.01)
    for step in range(1, 601):
        axis.predict(1 / HZ)
        then = offset + rate * (step / HZ - lag_s)
        axis.fuse_offset(then + 0.05 * rng.standard_normal(), lag_s, 0.0025)
    assert axis.offset == pytest.approx(offset + rate * 20.0, abs=0.1)
    assert axis.rate == pytest.approx(rate, abs=0.1)
    assert 0.0 < axis.variance < 0.01
    assert axis.rate_variance > 0.0
