"""External vision: planted drift is found and mended; what should not be believed is not."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import ned_from_hfrd, quaternion_from_euler
from companion.kernel.messages import FlightMode
from sitl.autopilot.estimation.axis_filter import AxisFilter
from sitl.autopilot.estimation.vision_sample import VisionSample
from sitl.settings import EstimatorSettings, SitlSettings
from sitl.simulator import World

DRIFT_M_S = 0.2
DRIFTING = SitlSettings(estimator=EstimatorSettings(drift_ned_m_s=(DRIFT_M_S, 0.0, 0.0)))
HZ = 30
NOTHING = [math.nan] * 21


class OpenAir:
    """A room without walls."""

    start_position_ned_m, start_yaw_rad = (0.0, 0.0, 0.0), 0.0

    def nearest(self, position_ned_m):
        return 100.0, (1.0, 0.0, 0.0)


class Mocap:
    """Motion capture of one flight, ``noise_m`` exact, in the frame whose origin is home."""

    def __init__(self, flight, noise_m=0.005):
        self.flight = flight
        self.noise_m = noise_m
        self.rng = np.random.default_rng(5)
        self.seen = []

    def look(self, **changes):
        world = self.flight.world
        truth, home_m = world.truth, world.room_from_home_m
        place_m = np.subtract(truth.position_ned_m, home_m)
        sample = VisionSample(
            world.time_s,
            tuple(place_m + self.noise_m * self.rng.standard_normal(3)),
            quaternion_from_euler(*truth.euler_rad),
        )
        self.seen.append(sample)
        return sample._replace(**changes)

    def send(self, **changes):
        self.flight.autopilot.take_vision(self.look(**changes))

    def run(self, duration_s, send=None):
        """Lets the flight go on, and hands over a sample at every frame of the cameras."""
        for _ in range(round(duration_s * HZ)):
            (send or self.send)()
            self.flight.world.advance_to(self.flight.world.time_s + 1 / HZ)

    def error_m(self):
        """(level, down) of the estimate."""
        truth, home_m = self.flight.world.truth, self.flight.world.room_from_home_m
        north, east, down = np.subtract(
            self.flight.autopilot.estimate.position_ned_m,
            np.subtract(truth.position_ned_m, home_m),
        )
        return math.hypot(north, east), abs(down)


@pytest.fixture
def drifting(make_flight):
    return Mocap(make_flight(settings=DRIFTING))


def test_without_vision_the_planted_drift_runs_away(drifting):
    drifting.flight.run(10.0)
    assert drifting.error_m()[0] == pytest.approx(DRIFT_M_S * 10.0, abs=0.3)


def test_with_vision_it_is_bounded_and_the_velocity_is_right(drifting):
    drifting.run(10.0)
    assert drifting.error_m()[0] < 0.05
    assert drifting.flight.autopilot.estimate.velocity_ned_m_s[0] == pytest.approx(0.0, abs=0.06)
    quality = drifting.flight.autopilot.quality
    assert quality.absolute
    assert quality.level_deviation_m < 0.1


def test_a_vehicle_in_the_air_stays_where_it_is_only_with_vision(make_flight):
    places = []
    for seeing in (False, True):
        mocap = Mocap(make_flight())
        mocap.run(3.0)
        mocap.flight.take_off()
        mocap.flight.autopilot.set_drift((DRIFT_M_S, 0.0, 0.0))
        mocap.run(20.0, None if seeing else lambda: None)
        home_m = mocap.flight.world.room_from_home_m
        places.append(np.subtract(mocap.flight.world.truth.position_ned_m, home_m)[0])
    blind_m, seeing_m = places
    assert blind_m == pytest.approx(-DRIFT_M_S * 20.0, rel=0.2)
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
def test_late_samples_are_compared_with_what_was_then(make_flight, delay_ms):
    """At 1 m/s samples that are 150 ms old are 0.15 m behind, unless that is known."""
    mocap = Mocap(make_flight(), noise_m=0.0)
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


def test_a_stamp_of_the_vehicles_clock_says_how_old_a_sample_is(make_flight):
    mocap = Mocap(make_flight(), noise_m=0.0)
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


def test_a_jump_is_not_believed_until_it_lasts(drifting):
    jumped_m = (2.0, 0.0, 0.0)
    drifting.run(2.0)
    before = drifting.flight.autopilot.quality.resets
    drifting.run(1.0, lambda: drifting.send(position_m=jumped_m))
    assert drifting.flight.autopilot.quality.ratios.level > 1.0
    assert drifting.error_m()[0] < 0.15
    drifting.run(1.0)
    assert drifting.error_m()[0] < 0.05
    drifting.run(7.0, lambda: drifting.send(position_m=jumped_m))
    assert drifting.error_m()[0] == pytest.approx(2.0, abs=0.05)
    assert drifting.flight.autopilot.quality.resets == before + 1


def test_a_client_that_announces_its_jump_is_believed_at_once(drifting):
    drifting.run(2.0)
    drifting.run(0.5, lambda: drifting.send(position_m=(2.0, 0.0, 0.0), reset_counter=1))
    assert drifting.error_m()[0] == pytest.approx(2.0, abs=0.05)


def test_what_is_held_goes_along_with_a_jump(make_flight):
    """A client whose origin is elsewhere begins in flight: the vehicle stays, home does not."""
    mocap = Mocap(make_flight())
    mocap.flight.take_off()
    before = mocap.flight.world.truth.position_ned_m

    def send():
        north, east, down = mocap.look().position_m
        mocap.send(position_m=(north + 3.0, east, down))

    mocap.run(6.0, send)
    assert mocap.flight.autopilot.estimate.position_ned_m[0] == pytest.approx(3.0, abs=0.3)
    assert math.dist(mocap.flight.world.truth.position_ned_m, before) < 0.3


@pytest.mark.parametrize(
    "changes",
    [
        {"position_m": (math.nan, 0.0, 0.0), "attitude": None},
        {"position_m": (math.inf, 0.0, 0.0), "attitude": None},
        {"position_m": (1e6, 0.0, 0.0), "attitude": None},
        {"quality_percent": -1},
        {"quality_percent": 20},
        {"stamp_s": 0.5},
    ],
    ids=["nan", "inf", "far away", "failed", "poor", "late"],
)
def test_unusable_samples_change_nothing(make_flight, changes):
    flight, other = make_flight(), make_flight()
    flight.autopilot.set_parameter("EKF2_EV_QMIN", 50)
    mocap = Mocap(flight)
    flight.run(2.0)
    other.run(2.0)
    mocap.run(1.0, lambda: mocap.send(**changes))
    other.world.advance_to(flight.world.time_s)
    assert flight.autopilot.estimate == other.autopilot.estimate


def test_duplicates_and_what_is_overtaken_are_dropped(drifting):
    drifting.run(3.0)
    newest = drifting.seen[-1]
    before = drifting.flight.autopilot.quality
    for stale in (newest, drifting.seen[-4]):
        drifting.flight.autopilot.take_vision(stale._replace(position_m=(0.1, 0.1, 0.0)))
    drifting.flight.world.advance_to(drifting.flight.world.time_s + 0.02)
    assert drifting.flight.autopilot.quality.ratios == before.ratios


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


ANY = st.one_of(st.floats(), st.floats(-3.0, 3.0))
ANY3 = st.tuples(ANY, ANY, ANY)


@settings(max_examples=40)
@given(
    st.lists(
        st.builds(
            VisionSample,
            stamp_s=ANY,
            position_m=ANY3,
            attitude=st.none() | st.just((1.0, 0.0, 0.0, 0.0)),
            velocity_m_s=ANY3,
            velocity_in_body=st.booleans(),
            north_known=st.booleans(),
            position_variance_m2=ANY3,
            yaw_variance_rad2=ANY,
            velocity_variance_m2_s2=ANY3,
            reset_counter=st.integers(0, 255),
            quality_percent=st.integers(-1, 100),
        ),
        max_size=12,
    ),
)
def test_no_sample_makes_the_estimate_anything_but_a_number(samples):
    room = OpenAir()
    world = World(room, SitlSettings(), 1, room)
    for sample in samples:
        world.autopilot.take_vision(sample)
        if sample.reset_counter % 2:
            world.advance_to(world.time_s + 0.02)
    world.advance_to(world.time_s + 0.1)
    estimate, quality = world.autopilot.estimate, world.autopilot.quality
    numbers = (*estimate.position_ned_m, *estimate.velocity_ned_m_s, estimate.yaw_rad)
    assert all(abs(number) < 1e5 for number in numbers)
    assert quality.level_deviation_m >= 0.0


# -- over MAVLink ----------------------------------------------------------------------------------


def odometry(frame=mavlink.MAV_FRAME_LOCAL_NED, value=0.0):
    q = quaternion_from_euler(0.0, 0.0, 0.5)  # as it stands in the tests' open air
    return mavlink.MAVLink_odometry_message(
        *(0, frame, mavlink.MAV_FRAME_BODY_FRD, value, 0.0, 0.0, q),
        *(value, 0.0, 0.0, 0.0, 0.0, 0.0, NOTHING, NOTHING),
    )


POSES = {
    "ODOMETRY": odometry(),
    "ODOMETRY as MAVSDK has it": odometry(14),
    "VISION_POSITION_ESTIMATE": mavlink.MAVLink_vision_position_estimate_message(
        0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, NOTHING
    ),
    "ATT_POS_MOCAP": mavlink.MAVLink_att_pos_mocap_message(
        0, quaternion_from_euler(0.0, 0.0, 0.5), 0.0, 0.0, 0.0, NOTHING
    ),
}


def drift_m(flight, message, duration_s=5.0):
    """How far the estimate has walked from home after that many seconds of such messages."""
    for _ in range(round(duration_s * 20)):
        if message is not None:
            flight.client.send(message)
        flight.run(0.05)
    return math.hypot(*flight.autopilot.estimate.position_ned_m[:2])


@pytest.mark.parametrize("name", POSES)
def test_each_message_bounds_the_drift(fly_mavlink, name):
    flight = fly_mavlink(settings=DRIFTING)
    assert drift_m(flight, POSES[name]) < 0.05
    flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS)
    (status,) = flight.answers("ESTIMATOR_STATUS")
    assert status.flags & mavlink.ESTIMATOR_POS_HORIZ_ABS
    assert 0.0 < status.pos_horiz_accuracy < 0.1


@pytest.mark.parametrize(
    "message",
    [None, odometry(mavlink.MAV_FRAME_LOCAL_ENU), odometry(value=math.nan)],
    ids=["nothing", "unknown frame", "nan"],
)
def test_what_cannot_be_used_does_not(fly_mavlink, message):
    assert drift_m(fly_mavlink(settings=DRIFTING), message) > 0.9


def test_speeds_slow_the_drift_down(fly_mavlink):
    still = mavlink.MAVLink_vision_speed_estimate_message(0, 0.0, 0.0, 0.0, [math.nan] * 9)
    assert drift_m(fly_mavlink(settings=DRIFTING), still) < 0.5
