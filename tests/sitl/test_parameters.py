"""Parameters: that they act, the protocol around them, and the file that keeps them."""

import math
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.errors import PlanError
from sitl.autopilot.interface import Ack
from sitl.autopilot.parameters import PARAMETERS, change_parameter, default_parameters
from sitl.mavlink.parameter_file import ParameterFile
from sitl.mavlink.parameters import parameters_hash

STORAGE = mavlink.MAV_CMD_PREFLIGHT_STORAGE
LOAD, SAVE, RESET = 0.0, 1.0, 2.0


def set_parameter(flight, name, value, kind=mavlink.MAV_PARAM_TYPE_REAL32):
    flight.client.send(mavlink.MAVLink_param_set_message(1, 1, name, value, kind))
    return [m.param_value for m in flight.answers("PARAM_VALUE")]


def bits(value):
    return struct.unpack("<f", struct.pack("<i", value))[0]


@pytest.mark.parametrize("name", PARAMETERS)
def test_no_parameter_leaves_its_range(name):
    values, limits = default_parameters(), PARAMETERS[name]
    assert limits.lowest <= limits.default <= limits.highest
    for wrong in (limits.lowest - 1, limits.highest + 1, math.nan, math.inf):
        assert not change_parameter(values, name, wrong)
    assert values == default_parameters()
    assert change_parameter(values, name, limits.highest)
    assert type(values[name]) is type(limits.default)


def test_a_value_out_of_range_is_answered_with_the_one_that_stays(fly_mavlink):
    flight = fly_mavlink()
    assert set_parameter(flight, b"MIS_TAKEOFF_ALT", 1e6) == [2.5]
    assert set_parameter(flight, b"MIS_TAKEOFF_ALT", math.nan) == [2.5]
    assert set_parameter(flight, b"NO_SUCH_NAME", 1.0) == []
    five = bits(5)
    assert set_parameter(flight, b"COM_OBL_RC_ACT", five, mavlink.MAV_PARAM_TYPE_INT32) == [five]
    assert set_parameter(flight, b"COM_OBL_RC_ACT", 1.0, mavlink.MAV_PARAM_TYPE_REAL64) == [five]


def test_the_hash_is_px4s_and_changes_with_every_value(fly_mavlink):
    flight = fly_mavlink()

    def hash_of_vehicle():
        (value,) = flight.value_of(b"_HASH_CHECK")
        return struct.unpack("<I", struct.pack("<f", value))[0]

    before = hash_of_vehicle()
    assert before == parameters_hash(flight.autopilot.parameters)
    flight.autopilot.set_parameter("MPC_XY_P", 1.0)
    assert hash_of_vehicle() != before
    flight.client.send(mavlink.MAVLink_param_request_list_message(1, 1))
    assert flight.answers("PARAM_VALUE")[0].param_id == "_HASH_CHECK"
    flight.autopilot.set_parameter("MAV_HASH_CHK_EN", 0)
    flight.client.send(mavlink.MAVLink_param_request_list_message(1, 1))
    assert flight.answers("PARAM_VALUE")[0].param_index == 0


@given(st.integers(-(2**31), 2**31 - 1), st.floats(width=32, allow_nan=False))
def test_the_hash_is_a_crc_without_inversions(whole, real):
    data = b"A" + struct.pack("<i", whole) + b"B" + struct.pack("<f", real)
    register = 0
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xEDB88320 if register & 1 else 0)
    assert parameters_hash({"B": real, "A": whole}) == register
    assert register != zlib.crc32(data)


def test_what_is_saved_comes_back_with_the_next_vehicle(fly_mavlink, tmp_path):
    path = tmp_path / "saved.params"
    flight = fly_mavlink(parameter_file=ParameterFile(path))
    flight.autopilot.set_parameter("MIS_TAKEOFF_ALT", 1.1)
    flight.autopilot.set_parameter("MAV_SYS_ID", 3)
    assert flight.acks(STORAGE, SAVE) == [Ack.ACCEPTED]
    flight.autopilot.set_parameter("MIS_TAKEOFF_ALT", 1.7)
    assert flight.acks(STORAGE, LOAD) == [Ack.ACCEPTED]
    assert flight.autopilot.parameters["MIS_TAKEOFF_ALT"] == 1.1
    assert flight.acks(STORAGE, RESET) == [Ack.ACCEPTED]
    assert flight.autopilot.parameters == default_parameters()

    another = fly_mavlink(parameter_file=ParameterFile(path))
    assert another.autopilot.parameters["MIS_TAKEOFF_ALT"] == 1.1
    assert {message.get_srcSystem() for message in another.run(1.1)} == {3}


def test_a_file_that_cannot_be_written_fails_the_command(fly_mavlink, tmp_path, caplog):
    flight = fly_mavlink(parameter_file=ParameterFile(tmp_path / "gone" / "saved.params"))
    assert flight.acks(STORAGE, SAVE) == [Ack.FAILED]
    assert "parameters cannot be saved: No such file" in caplog.text
    assert flight.acks(STORAGE, 9.0) == [Ack.DENIED]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "1\t1\tMIS_TAKEOF_ALT\t2.0\t9\n",
            r":1: MIS_TAKEOF_ALT: .* mean 'MIS_TAKEOFF_ALT'",
        ),
        ("# x\n1 1 MIS_TAKEOFF_ALT 99 9\n", r":2: MIS_TAKEOFF_ALT: 99: allowed: 0 to 80$"),
        ("1 1 MIS_TAKEOFF_ALT nan 9\n", "nan: allowed"),
        ("MIS_TAKEOFF_ALT\n", r":1: not 'system component name value type'$"),
        ("1 1 MIS_TAKEOFF_ALT much 9\n", "not 'system"),
        ("ä\n", "not a parameter file"),
    ],
)
def test_a_bad_file_is_refused_with_its_line(tmp_path, content, message):
    path = tmp_path / "bad.params"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(PlanError, match=message):
        ParameterFile(path)


@given(st.dictionaries(st.sampled_from(sorted(PARAMETERS)), st.floats(0.0, 1.0)))
def test_a_file_keeps_every_value_exactly(tmp_path_factory, shares):
    values = default_parameters()
    for name, share in shares.items():
        limits = PARAMETERS[name]
        change_parameter(values, name, limits.lowest + share * (limits.highest - limits.lowest))
    path = tmp_path_factory.mktemp("parameters") / "file"
    assert ParameterFile(path).save(values)
    assert ParameterFile(path).last == values


# -- that they act -------------------------------------------------------------------------------


def test_arming_may_be_forbidden_or_need_more_charge(flight):
    flight.get_ready()
    flight.autopilot.set_parameter("COM_ARMABLE", 0)
    assert flight.autopilot.arm() is Ack.TEMPORARILY_REJECTED
    assert flight.said("Arming denied: not allowed by COM_ARMABLE")
    flight.autopilot.set_parameter("COM_ARMABLE", 1)
    flight.autopilot._battery.charge_norm = 0.5
    flight.autopilot.set_parameter("COM_ARM_BAT_MIN", 0.6)
    assert flight.autopilot.arm() is Ack.TEMPORARILY_REJECTED
    flight.autopilot.set_parameter("COM_ARM_BAT_MIN", 0.4)
    assert flight.autopilot.arm() is Ack.ACCEPTED


def test_the_pack_has_the_cells_and_the_resistance_that_are_set(flight):
    flight.run(0.1)
    three_v, current_a = flight.status.battery_voltage_v, flight.status.battery_current_a
    flight.autopilot.set_parameter("BAT1_R_INTERNAL", 0.16)
    flight.run(0.1)
    assert three_v - flight.status.battery_voltage_v == pytest.approx(0.1 * current_a, rel=0.05)
    flight.autopilot.set_parameter("BAT1_R_INTERNAL", 0.0)
    flight.autopilot.set_parameter("BAT1_N_CELLS", 4)
    flight.run(0.1)
    assert flight.status.battery_voltage_v == pytest.approx(4 * 4.18, abs=0.05)


def test_the_simulated_charge_stops_at_its_floor(flight):
    flight.autopilot.set_parameter("SIM_BAT_MIN_PCT", 50.0)
    flight.autopilot._battery.charge_norm = 0.5001
    flight.run(5.0)
    assert flight.status.battery_norm == 0.5


def test_wind_comes_from_where_the_parameters_say(airborne):
    airborne.autopilot.set_parameter("SIH_WIND_N", 3.0)
    airborne.run(8.0)
    assert airborne.world.truth.euler_rad[1] < -math.radians(4.0)  # nose down into it
    airborne.autopilot.set_parameter("SIH_WIND_N", 0.0)
    airborne.run(8.0)
    assert abs(airborne.world.truth.euler_rad[1]) < math.radians(2.0)


def test_the_gains_of_the_rate_loops_act(make_flight):
    def roll_after(gain):
        flight = make_flight()
        flight.autopilot.set_parameter("MC_ROLLRATE_K", gain)
        flight.take_off()
        flight.world.airframe.command(0.2, 0.0, 0.0, 0.55)
        for _ in range(5):
            flight.world.airframe.step()
        return flight.world.airframe.read().rates_frd_rad_s[0]

    assert roll_after(1.5) > 1.15 * roll_after(1.0) > 1.3 * roll_after(0.5)


@pytest.mark.parametrize(
    ("name", "value", "follower", "set_to"),
    [
        ("MPC_XY_VEL_ALL", 0.8, "MPC_XY_CRUISE", 0.8),
        ("MPC_XY_VEL_ALL", 0.8, "MPC_XY_VEL_MAX", 0.8),
        ("MPC_XY_VEL_ALL", -1.0, "MPC_XY_VEL_MAX", 2.0),
        ("MPC_Z_VEL_ALL", 1.0, "MPC_Z_VEL_MAX_DN", 0.75),
    ],
)
def test_overall_speeds_set_the_others(name, value, follower, set_to):
    values = default_parameters()
    change_parameter(values, name, value)
    assert values[follower] == set_to


def test_yaw_accelerates_no_faster_than_it_may(airborne):
    airborne.autopilot.set_parameter("MPC_YAWRAUTO_ACC", 20.0)
    rates = [state.rates_frd_rad_s[2] for state in airborne.fly(1.0, yaw_rate_rad_s=1.0)]
    assert rates[-1] == pytest.approx(math.radians(20.0), rel=0.25)
    airborne.autopilot.set_parameter("MC_YAWRATE_MAX", 30.0)
    rates = [state.rates_frd_rad_s[2] for state in airborne.fly(3.0, yaw_rate_rad_s=1.0)]
    assert rates[-1] == pytest.approx(math.radians(30.0), rel=0.1)


def test_lift_grows_over_the_ramp(make_flight):
    def liftoff_s(ramp_s):
        flight = make_flight()
        flight.autopilot.set_parameter("MPC_TKO_RAMP_T", ramp_s)
        flight.get_ready()
        flight.autopilot.arm()
        flight.autopilot.take_off(1.0)
        return flight.wait_until(lambda: flight.world.truth.position_ned_m[2] < -0.1, 10.0)

    assert liftoff_s(3.0) - liftoff_s(1.0) == pytest.approx(2.0, abs=0.5)


def test_a_landing_is_felt_in_the_time_that_is_set(make_flight):
    def landed_s(trigger_s):
        flight = make_flight()
        flight.autopilot.set_parameter("LNDMC_TRIG_TIME", trigger_s)
        flight.take_off()
        flight.autopilot.land()
        return flight.wait_until(lambda: not flight.autopilot.airborne, 20.0)

    assert landed_s(2.0) - landed_s(0.8) == pytest.approx(1.2, abs=0.15)


def test_thrust_stays_within_its_limits(airborne):
    airborne.autopilot.set_parameter("MPC_THR_MAX", 0.6)
    airborne.fly(1.0, down_m_s=-1.5)
    assert airborne.status.thrust_norm <= 0.6
    airborne.autopilot.set_parameter("MPC_THR_MIN", 0.5)
    airborne.send(down_m_s=1.5)
    thrusts = []
    airborne.run(1.0, lambda: thrusts.append(airborne.status.thrust_norm))
    assert min(thrusts) >= 0.499


def test_simulated_sensors_are_read_as_set(fly_mavlink):
    flight = fly_mavlink()

    def read(number, name):
        flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)
        return flight.answers(name)[0]

    plain = read(29, "SCALED_PRESSURE")
    assert plain.press_abs == pytest.approx(1012.05, abs=0.1)  # ISA at 10 m
    for name, value in (("SIM_BARO_OFF_P", 2.0), ("SIM_BARO_OFF_T", -5.0), ("MAV_TYPE", 13)):
        flight.autopilot.set_parameter(name, value)
    shifted = read(29, "SCALED_PRESSURE")
    assert shifted.press_abs - plain.press_abs == pytest.approx(2.0, abs=1e-3)
    assert shifted.temperature - plain.temperature == -500
    assert read(0, "HEARTBEAT").type == mavlink.MAV_TYPE_HEXAROTOR
    for name, value in (("SIH_DISTSNSR_MIN", 0.5), ("SIH_DISTSNSR_MAX", 3.0)):
        flight.autopilot.set_parameter(name, value)
    distance = read(132, "DISTANCE_SENSOR")
    measured = distance.min_distance, distance.current_distance, distance.max_distance
    assert measured == (50, 50, 300)
    flight.autopilot.set_parameter("SIH_DISTSNSR_OVR", 1.25)
    assert read(132, "DISTANCE_SENSOR").current_distance == 125
