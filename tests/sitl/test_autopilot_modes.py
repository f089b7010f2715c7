"""Modes and the ways between them, beyond hold, take-off, landing and offboard velocity."""

import math

import pytest

from companion.kernel.messages import NAN, FlightMode, LandedState
from sitl.autopilot.interface import Ack, AttitudeSetpoint, ManualInput, OffboardSetpoint
from sitl.autopilot.mission import Waypoint
from sitl.mavlink import modes

CENTRED = ManualInput(0.0, 0.0, 0.0, 0.0)
NO_RATES = (NAN, NAN, 0.0)
HOVER_NORM = 0.507  # of this airframe: Parrot's 0.42 kg against four times 2.03 N


def load_waypoint(flight):
    flight.autopilot.plans.mission.load([Waypoint((2.0, 0.0, -1.5), hold_s=math.inf)])


PREPARATIONS = {
    FlightMode.OFFBOARD: lambda flight: flight.send(),
    FlightMode.POSITION: lambda flight: flight.autopilot.set_manual_input(CENTRED),
    FlightMode.MISSION: load_waypoint,
}
IN_FLIGHT = [
    FlightMode.HOLD,
    FlightMode.POSITION,
    FlightMode.MISSION,
    FlightMode.RTL,
    FlightMode.LAND,
    FlightMode.OFFBOARD,
]


def prepare(flight, mode):
    PREPARATIONS.get(mode, lambda _: None)(flight)


@pytest.mark.parametrize(
    ("mode", "custom_mode", "base_mode"),
    [
        (FlightMode.POSITION, 0x00030000, 209),
        (FlightMode.TAKEOFF, 0x02040000, 157),
        (FlightMode.HOLD, 0x03040000, 157),
        (FlightMode.MISSION, 0x04040000, 157),
        (FlightMode.RTL, 0x05040000, 157),
        (FlightMode.LAND, 0x06040000, 157),
        (FlightMode.OFFBOARD, 0x00060000, 145),
    ],
)
def test_modes_have_px4s_numbers(mode, custom_mode, base_mode):
    assert modes.custom_mode(mode) == custom_mode
    assert modes.base_mode(mode, armed=True) == base_mode
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24
    assert modes.requested_mode(129, main, sub) is mode


@pytest.mark.parametrize(
    ("ready", "armed", "failsafe", "state"),
    [
        (False, False, False, 0),
        (True, False, False, 3),
        (True, True, False, 4),
        (True, True, True, 5),
    ],
)
def test_a_failsafe_is_told_as_critical(ready, armed, failsafe, state):
    assert modes.system_status(ready, armed, failsafe) == state


def test_from_every_mode_to_every_other(airborne):
    for before in IN_FLIGHT:
        for after in IN_FLIGHT:
            for mode in (before, after):
                prepare(airborne, before)
                prepare(airborne, after)
                assert airborne.autopilot.set_mode(mode) is Ack.ACCEPTED, (before, after)
                airborne.world.advance_to(airborne.world.time_s + 0.04)
                assert airborne.status.mode is mode
    assert airborne.autopilot.set_mode(FlightMode.MANUAL) is Ack.TEMPORARILY_REJECTED
    assert airborne.autopilot.set_mode(FlightMode.TAKEOFF) is Ack.TEMPORARILY_REJECTED


def test_return_climbs_comes_home_and_lands(airborne):
    airborne.fly(5.0, north_m_s=0.6, down_m_s=0.1)
    airborne.autopilot.set_parameter("RTL_RETURN_ALT", 2.0)
    assert airborne.autopilot.set_mode(FlightMode.RTL) is Ack.ACCEPTED
    first = len(airborne.states)
    airborne.run(20.0)
    path = [state.position_ned_m for state in airborne.states[first:]]
    on_the_way = [-down for north, _, down in path if 1.0 < north < 2.0 and down < -0.5]
    assert on_the_way == pytest.approx([2.0 + 0.06] * len(on_the_way), abs=0.3)
    assert math.hypot(*path[-1][:2]) < 0.5
    assert not airborne.status.armed
    assert airborne.said("Disarmed by landing")


def test_return_goes_to_the_nearest_rally_point(airborne):
    airborne.autopilot.plans.rally_ned_m = ((3.0, 0.0, 0.0), (40.0, 0.0, 0.0))
    airborne.fly(5.0, north_m_s=0.6)
    airborne.autopilot.set_mode(FlightMode.RTL)
    airborne.wait_until(lambda: not airborne.status.armed, 25.0)
    assert airborne.world.truth.position_ned_m[0] == pytest.approx(3.0, abs=0.5)


def test_a_negative_delay_waits_over_home(airborne):
    airborne.autopilot.set_parameter("RTL_LAND_DELAY", -1.0)
    airborne.autopilot.set_mode(FlightMode.RTL)
    airborne.run(20.0)
    assert airborne.status.landed_state is LandedState.IN_AIR
    assert -airborne.autopilot.estimate.position_ned_m[2] == pytest.approx(1.0, abs=0.15)


def push(flight, duration_s, sticks):
    flight.run(duration_s, lambda: flight.autopilot.set_manual_input(sticks))
    return flight.world.truth


def test_sticks_fly_and_centred_sticks_hold(make_flight, make_hall):
    flight = make_flight(hall=make_hall(start_yaw_rad=math.pi / 2))
    flight.take_off()
    flight.autopilot.set_manual_input(CENTRED)
    assert flight.autopilot.set_mode(FlightMode.POSITION) is Ack.ACCEPTED
    moving = push(flight, 4.0, ManualInput(0.55, 0.0, 0.0, 0.0))
    assert moving.velocity_ned_m_s == pytest.approx((0.0, 0.5, 0.0), abs=0.08)  # nose to the east
    stopped = push(flight, 3.0, CENTRED)
    later = push(flight, 5.0, CENTRED)
    assert later.position_ned_m == pytest.approx(stopped.position_ned_m, abs=0.25)
    climbing = push(flight, 2.0, ManualInput(0.0, 0.0, 1.0, 0.0))
    assert climbing.velocity_ned_m_s[2] < -1.0
    turning = push(flight, 2.0, ManualInput(0.0, 0.0, 0.0, -1.0))
    assert turning.rates_frd_rad_s[2] == pytest.approx(-math.pi / 2, abs=0.1)


def test_sticks_take_off_and_land(flight):
    flight.get_ready()
    flight.autopilot.set_manual_input(CENTRED)
    flight.autopilot.set_mode(FlightMode.POSITION)
    flight.autopilot.arm()
    push(flight, 2.0, CENTRED)
    assert flight.status.landed_state is LandedState.ON_GROUND
    push(flight, 3.0, ManualInput(0.0, 0.0, 0.6, 0.0))
    assert flight.status.landed_state is LandedState.IN_AIR
    push(flight, 8.0, ManualInput(0.0, 0.0, -0.6, 0.0))
    assert not flight.status.armed
    assert flight.world.crashed is None


def stream(flight, setpoint, duration_s):
    flight.autopilot.set_offboard_setpoint(setpoint)
    if flight.status.mode is not FlightMode.OFFBOARD:
        assert flight.autopilot.set_mode(FlightMode.OFFBOARD) is Ack.ACCEPTED
    flight.run(duration_s, lambda: flight.autopilot.set_offboard_setpoint(setpoint))
    return flight.world.truth


def test_an_acceleration_alone_gains_speed(airborne):
    setpoint = OffboardSetpoint(
        velocity_ned_m_s=(NAN, NAN, 0.0), acceleration_ned_m_s2=(0.8, -0.4, NAN)
    )
    velocity = stream(airborne, setpoint, 2.0).velocity_ned_m_s
    # Against the drag of aerodynamics.xml, 0.54 1/s, from the tilt's lag of 0.15 s on.
    gained_s = (1.0 - math.exp(-0.54 * (2.0 - 0.15))) / 0.54
    assert velocity == pytest.approx((0.8 * gained_s, -0.4 * gained_s, 0.0), abs=0.1)
    stopped = airborne.fly(4.0)[-1]
    assert math.hypot(*stopped.velocity_ned_m_s) < 0.1


def test_an_upward_acceleration_climbs(airborne):
    setpoint = OffboardSetpoint(acceleration_ned_m_s2=(0.0, 0.0, -0.5))
    assert stream(airborne, setpoint, 1.0).velocity_ned_m_s[2] == pytest.approx(-0.5, abs=0.2)


def test_an_attitude_is_flown_with_its_thrust(make_flight, make_hall):
    flight = make_flight(hall=make_hall())
    flight.take_off(4.0)
    wanted = AttitudeSetpoint(0.1, -0.15, 0.5, NO_RATES, HOVER_NORM * 1.02)
    truth = stream(flight, wanted, 2.0)
    assert truth.euler_rad == pytest.approx((0.1, -0.15, 0.5), abs=0.05)
    assert abs(truth.velocity_ned_m_s[2]) < 1.0
    flight.run(2.0)  # nothing comes any more
    assert flight.said("Failsafe activated")
    assert math.hypot(*flight.run(8.0).velocity_ned_m_s) < 1.2


def test_attitude_rates_turn_the_vehicle(airborne):
    climb = HOVER_NORM * 1.1
    wanted = AttitudeSetpoint(NAN, NAN, NAN, (0.3, 0.0, 0.4), climb)
    truth = stream(airborne, wanted, 0.7)
    assert truth.rates_frd_rad_s[0] == pytest.approx(0.3, abs=0.06)
    assert truth.rates_frd_rad_s[2] == pytest.approx(0.4, abs=0.08)
    assert truth.euler_rad[0] == pytest.approx(0.3 * 0.7, abs=0.06)
    level = stream(airborne, AttitudeSetpoint(0.0, 0.0, NAN, NO_RATES, climb), 1.0)
    assert level.euler_rad[:2] == pytest.approx((0.0, 0.0), abs=0.03)


def test_attitude_mode_takes_off_and_lands_by_thrust(flight):
    flight.get_ready()
    up = AttitudeSetpoint(0.0, 0.0, NAN, NO_RATES, HOVER_NORM * 1.15)
    flight.autopilot.set_offboard_setpoint(up)
    flight.autopilot.set_mode(FlightMode.OFFBOARD)
    assert flight.autopilot.arm() is Ack.ACCEPTED
    stream(flight, up, 3.0)
    assert flight.status.landed_state is LandedState.IN_AIR
    stream(flight, up._replace(thrust_norm=HOVER_NORM * 0.93), 8.0)
    stream(flight, up._replace(thrust_norm=HOVER_NORM * 0.7), 5.0)
    assert flight.status.landed_state is LandedState.ON_GROUND


def test_thrust_alone_takes_off_from_the_ground(flight):
    flight.get_ready()
    thrust = [0.0]

    def push():
        flight.autopilot.set_offboard_setpoint(
            AttitudeSetpoint(0.0, 0.0, 0.0, (NAN, NAN, NAN), thrust[0])
        )

    push()
    flight.autopilot.arm()
    assert flight.autopilot.set_mode(FlightMode.OFFBOARD) is Ack.ACCEPTED
    flight.run(1.0, push)
    thrust[0] = 0.7
    flight.run(3.0, push)
    assert flight.world.truth.position_ned_m[2] < -1.0
    assert flight.said("Landing detected") == []


def test_return_lands_on_a_home_that_was_moved(airborne):
    assert airborne.autopilot.set_home((3.0, -2.0, 0.0)) is Ack.ACCEPTED
    assert airborne.autopilot.set_mode(FlightMode.RTL) is Ack.ACCEPTED
    airborne.wait_until(lambda: not airborne.status.armed, 40.0)
    assert airborne.autopilot.estimate.position_ned_m[:2] == pytest.approx((3.0, -2.0), abs=0.2)


def test_setpoints_from_before_a_reboot_are_forgotten(flight):
    flight.get_ready()
    flight.send(0.5)
    assert flight.autopilot.reboot() is Ack.ACCEPTED
    flight.get_ready()
    assert flight.autopilot.set_mode(FlightMode.OFFBOARD) is Ack.ACCEPTED
    assert flight.autopilot.arm() is Ack.TEMPORARILY_REJECTED
    assert len(flight.said("Arming denied: no offboard setpoints")) == 1
    flight.send()
    assert flight.autopilot.arm() is Ack.ACCEPTED
