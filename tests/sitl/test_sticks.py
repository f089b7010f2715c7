"""Sticks that take the vehicle over, and joysticks that are not listened to."""

import pytest

from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import ManualInput

HOLD, RTL, OFFBOARD = FlightMode.HOLD, FlightMode.RTL, FlightMode.OFFBOARD


def stick(flight, forward_norm, duration_s=0.5):
    """MANUAL_CONTROL at 10 Hz."""
    sticks = ManualInput(forward_norm, 0.0, 0.0, 0.0)
    flight.run(duration_s, lambda: flight.autopilot.set_manual_input(sticks))


def test_moved_sticks_take_over_where_com_rc_override_says_so(airborne):
    airborne.autopilot.set_parameter("COM_OF_LOSS_T", 60.0)
    airborne.send()
    cases = [(1, HOLD), (0, HOLD), (2, HOLD), (1, RTL), (1, OFFBOARD), (2, OFFBOARD)]
    taken = []
    for override, asked in cases:
        airborne.autopilot.set_parameter("COM_RC_OVERRIDE", 0)
        stick(airborne, 0.0, 1.5)
        airborne.autopilot.set_parameter("COM_RC_OVERRIDE", override)
        airborne.autopilot.set_mode(asked)
        stick(airborne, 0.0)
        assert airborne.status.mode is asked
        stick(airborne, 0.6)
        taken.append(airborne.status.mode is FlightMode.POSITION)
    assert taken == [True, False, False, True, False, True]
    assert len(airborne.said("Pilot took over using sticks")) == 3


def test_sticks_that_rest_anywhere_or_move_a_little_do_not(airborne):
    stick(airborne, 0.7, 2.0)
    assert airborne.status.mode is HOLD
    stick(airborne, 0.9)
    assert airborne.status.mode is HOLD
    stick(airborne, 0.0)
    assert airborne.status.mode is FlightMode.POSITION


@pytest.mark.parametrize(("value", "heard"), [(0, False), (1, True), (3, True), (4, False)])
def test_com_rc_in_mode_says_whether_a_joystick_counts(flight, value, heard):
    flight.autopilot.set_parameter("COM_RC_IN_MODE", value)
    stick(flight, 0.0)
    flight.autopilot.set_mode(FlightMode.POSITION)
    assert (flight.status.mode is FlightMode.POSITION) is heard
