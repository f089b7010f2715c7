"""What the sensors tell: the truth, and all of them the same one."""

import math
from collections import Counter

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import matrix_from_euler
from sitl.autopilot.interface import Ack
from sitl.failures import SUPPORTED, Failures, Kind, Unit
from sitl.mavlink.places import Origin
from sitl.sensors.nature import air_at, height_amsl_m

NAMES = (
    *("HIGHRES_IMU", "SCALED_IMU", "SCALED_PRESSURE", "DISTANCE_SENSOR", "OPTICAL_FLOW_RAD"),
    *("GPS_RAW_INT", "ODOMETRY", "ESTIMATOR_STATUS", "LOCAL_POSITION_NED", "SYS_STATUS"),
)
DECLINATION_RAD = math.radians(2.3)


def told(flight, *names):
    """These messages of one moment, by name; those that are not sent are missing."""
    flight.client.received()
    for name in names:
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)
    flight.server.poll()
    return {m.get_type(): m for m in flight.client.received() if m.get_type() in names}


@pytest.fixture(scope="module")
def moving(make_module_flight):
    """(messages, truth) of one moment of a flight at half a metre per second, turning."""
    flight = make_module_flight()
    flight.autopilot.set_parameter("SYS_HAS_GPS", 1)
    flight.take_off()
    flight.send_setpoint((0.5, 0.0, 0.0), 0.3)
    assert flight.acks(mavlink.MAV_CMD_DO_SET_MODE, 129.0, 6.0, 0.0) == [Ack.ACCEPTED] * 2
    for _ in range(30):
        flight.send_setpoint((0.5, 0.0, 0.0), 0.3)
        flight.run(0.1)
    return told(flight, *NAMES), flight.autopilot.sensors.truth


def test_the_imu_feels_the_motion(moving):
    messages, truth = moving
    imu = messages["HIGHRES_IMU"]
    assert (imu.xgyro, imu.ygyro, imu.zgyro) == pytest.approx(truth.rates_frd_rad_s, abs=0.01)
    felt = imu.xacc, imu.yacc, imu.zacc
    assert felt == pytest.approx(truth.specific_force_frd_m_s2, abs=0.2)
    scaled = messages["SCALED_IMU"]
    assert scaled.zacc == pytest.approx(imu.zacc * 1000 / 9.80665, abs=0.6)
    assert scaled.zgyro == pytest.approx(imu.zgyro * 1000, abs=0.6)
    assert scaled.xmag == pytest.approx(imu.xmag * 1000, abs=0.6)


def test_the_compass_points_to_magnetic_north(moving):
    messages, truth = moving
    imu = messages["HIGHRES_IMU"]
    roll, pitch, yaw = truth.euler_rad
    north, east, down = matrix_from_euler(roll, pitch, 0.0) @ (imu.xmag, imu.ymag, imu.zmag)
    heading_rad = DECLINATION_RAD - math.atan2(east, north)
    assert math.remainder(heading_rad - yaw, math.tau) == pytest.approx(0.0, abs=0.05)
    assert math.atan2(down, math.hypot(north, east)) == pytest.approx(math.radians(67), abs=0.05)


def test_barometer_and_range_finder_agree_on_the_height(moving):
    messages, truth = moving
    height_m = -truth.position_ned_m[2]
    imu, pressure = messages["HIGHRES_IMU"], messages["SCALED_PRESSURE"]
    assert pressure.press_abs == pytest.approx(imu.abs_pressure, abs=1e-3)
    assert imu.pressure_alt - Origin().amsl_m == pytest.approx(height_m, abs=0.5)
    slant = 1.0 / (math.cos(truth.euler_rad[0]) * math.cos(truth.euler_rad[1]))
    assert messages["DISTANCE_SENSOR"].current_distance == pytest.approx(
        100 * height_m * slant, abs=5
    )


def test_flow_times_distance_is_the_velocity(moving):
    messages, truth = moving
    flow = messages["OPTICAL_FLOW_RAD"]
    v_x, v_y, _ = matrix_from_euler(*truth.euler_rad).T @ truth.velocity_ned_m_s
    per_s = 1e6 / flow.integration_time_us
    forward_m_s = (flow.integrated_y - flow.integrated_ygyro) * per_s * flow.distance
    right_m_s = -(flow.integrated_x - flow.integrated_xgyro) * per_s * flow.distance
    assert (forward_m_s, right_m_s) == pytest.approx((v_x, v_y), abs=0.1)
    assert flow.quality == 255


def test_satellites_see_the_same_place(moving):
    messages, truth = moving
    fix = messages["GPS_RAW_INT"]
    assert (fix.fix_type, fix.satellites_visible) == (mavlink.GPS_FIX_TYPE_3D_FIX, 10)
    level_m = Origin().level_m(fix.lat * 1e-7, fix.lon * 1e-7)
    assert level_m == pytest.approx(truth.position_ned_m[:2], abs=2.0)
    assert fix.vel == pytest.approx(100 * math.hypot(*truth.velocity_ned_m_s[:2]), abs=25)


def test_the_estimate_knows_how_good_it_is(moving):
    messages, truth = moving
    pose, status = messages["ODOMETRY"], messages["ESTIMATOR_STATUS"]
    errors = np.subtract((pose.x, pose.y, pose.z), truth.position_ned_m)
    deviations = np.sqrt([pose.pose_covariance[place] for place in (0, 6, 11)])
    assert np.all(np.abs(errors) < 4 * deviations)
    assert np.all(deviations < 0.5)
    speeds = np.subtract((pose.vx, pose.vy, pose.vz), truth.velocity_ned_m_s)
    assert np.all(np.abs(speeds) < 4 * math.sqrt(pose.velocity_covariance[0]))
    assert status.pos_horiz_accuracy == pytest.approx(deviations[0], rel=1e-5)
    local = messages["LOCAL_POSITION_NED"]
    assert (pose.x, pose.y, pose.z) == pytest.approx((local.x, local.y, local.z), abs=1e-6)


def test_satellites_are_off_indoors(fly_mavlink):
    flight = fly_mavlink()
    assert told(flight, "GPS_RAW_INT")["GPS_RAW_INT"].fix_type == mavlink.GPS_FIX_TYPE_NO_FIX
    flight.autopilot.set_parameter("SYS_HAS_GPS", 1)
    flight.autopilot.set_parameter("SIM_GPS_USED", 3)
    assert told(flight, "GPS_RAW_INT")["GPS_RAW_INT"].fix_type == mavlink.GPS_FIX_TYPE_NO_FIX


SENDERS = {
    Unit.BAROMETER: "SCALED_PRESSURE",
    Unit.OPTICAL_FLOW: "OPTICAL_FLOW_RAD",
    Unit.RANGE_FINDER: "DISTANCE_SENSOR",
}


@pytest.mark.parametrize("unit", SENDERS)
def test_a_sensor_that_is_off_says_nothing_and_is_not_healthy(fly_mavlink, unit):
    flight = fly_mavlink()
    name = SENDERS[unit]
    assert flight.autopilot.failures.inject(unit, Kind.OFF)
    flight.run(0.1)
    counted = Counter(message.get_type() for message in flight.run(2.0))
    assert not counted[name]
    assert not told(flight, name)
    status = told(flight, "SYS_STATUS")["SYS_STATUS"]
    sick = status.onboard_control_sensors_enabled & ~status.onboard_control_sensors_health
    bits = {
        Unit.BAROMETER: mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
        Unit.OPTICAL_FLOW: mavlink.MAV_SYS_STATUS_SENSOR_OPTICAL_FLOW,
        Unit.RANGE_FINDER: mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION,
    }
    assert sick & bits[unit]
    flight.autopilot.failures.inject(unit, Kind.OK)
    flight.run(0.1)
    assert told(flight, name)


def test_stuck_means_the_same_and_garbage_means_nothing(fly_mavlink):
    flight = fly_mavlink()

    def pressures_hpa():
        values = []
        for _ in range(5):
            flight.run(0.05)
            values.append(told(flight, "SCALED_PRESSURE")["SCALED_PRESSURE"].press_abs)
        return values

    sound = pressures_hpa()
    assert len(set(sound)) > 1
    assert np.ptp(sound) < 0.2
    flight.autopilot.failures.inject(Unit.BAROMETER, Kind.STUCK)
    assert len(set(pressures_hpa())) == 1
    flight.autopilot.failures.inject(Unit.BAROMETER, Kind.GARBAGE)
    assert np.ptp(pressures_hpa()) > 50.0


def test_only_what_can_be_simulated_can_be_injected():
    failures = Failures()
    for unit in Unit:
        for kind in Kind:
            assert failures.inject(unit, kind) is (kind in SUPPORTED.get(unit, ()))
    for unit, kind, instance in ((99, 1, 0), (101, 99, 0), (101, 1, 5), (101, 1, -1), (4, 1, 2)):
        assert not failures.inject(unit, kind, instance)


def test_a_motor_fails_alone_or_with_all_others():
    failures = Failures()
    failures.inject(Unit.MOTOR, Kind.OFF, 2)
    assert failures.motor_efficiency_norm == (1.0, 0.0, 1.0, 1.0)
    failures.inject(Unit.MOTOR, Kind.SLOW)
    assert failures.motor_efficiency_norm == (0.75,) * 4
    failures.inject(Unit.MOTOR, Kind.OK)
    assert failures.motor_efficiency_norm == (1.0,) * 4


@pytest.mark.parametrize(("east_m", "expected_m"), [(3.0, 0.45), (1.0, 1.2)])
def test_over_a_desk_the_range_finder_sees_the_desk(make_flight, east_m, expected_m):
    class Desk:
        """A column of half a metre, 0.75 m high, 3 m east of the start."""

        start_position_ned_m, start_yaw_rad = (0.0, 0.0, 0.0), 0.0

        def nearest(self, position_ned_m):
            north, east, down = position_ned_m
            beside_m = max(abs(north), abs(east - 3.0)) - 0.25
            over_m = -0.75 - down
            outside_m = math.hypot(max(0.0, beside_m), max(0.0, over_m))
            return max(min(beside_m, over_m), outside_m), (0.0, 0.0, -1.0)

    flight = make_flight(hall=Desk())
    sensors = flight.autopilot.sensors
    sensors.truth = sensors.truth._replace(position_ned_m=(0.0, east_m, -1.2))
    assert sensors.range_m() == pytest.approx(expected_m, abs=0.05)


@pytest.mark.parametrize("roll_rad", [0.0, 0.5, math.pi / 2, math.pi])
def test_it_sees_as_far_as_its_axis_reaches_and_no_farther_than_it_can(flight, roll_rad):
    sensors = flight.autopilot.sensors
    sensors.truth = sensors.truth._replace(
        position_ned_m=(0.0, 0.0, -1.0), euler_rad=(roll_rad, 0.0, 1.0)
    )
    reach_m = 1.0 / math.cos(roll_rad) if roll_rad < 1.5 else sensors.range_limits_m[1]
    assert sensors.range_m() == pytest.approx(reach_m, abs=0.05)
    assert all(map(math.isfinite, sensors.flow().turned_rad))
    sensors.truth = sensors.truth._replace(time_s=99.0, position_ned_m=(0.0, 0.0, 0.0))
    assert math.isfinite(sensors.range_m())


@pytest.mark.parametrize("height_m", [-5.0, 0.0, 1.5, 100.0])
def test_the_standard_atmosphere_can_be_read_backwards(height_m):
    assert height_amsl_m(air_at(height_m).pressure_pa) == pytest.approx(height_m)
    assert air_at(10.0).pressure_pa == pytest.approx(101_205.0, abs=2.0)  # ISA at 10 m
