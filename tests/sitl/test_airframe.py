"""Physics identities and step responses of the airframe alone."""

import math

import pytest

from companion.kernel.errors import PlanError
from sitl.airframe import GRAVITY_M_S2, Airframe, AirframeState

HZ = 300


def run(airframe, duration_s):
    for _ in range(round(duration_s * HZ)):
        airframe.step()
    return airframe.read()


def fly(airframe, roll_rad, pitch_rad, yaw_rate_rad_s, duration_s) -> list[AirframeState]:
    """Holds these setpoints with the lift kept at the weight; every state on the way."""
    states = []
    state = airframe.read()
    for _ in range(round(duration_s * HZ)):
        upright = math.cos(state.euler_rad[0]) * math.cos(state.euler_rad[1])
        thrust_norm = airframe.hover_thrust_norm / upright
        airframe.command(roll_rad, pitch_rad, yaw_rate_rad_s, thrust_norm)
        airframe.step()
        state = airframe.read()
        states.append(state)
    return states


@pytest.fixture
def airframe():
    return Airframe("ardrone2", HZ, yaw_rad=0.3)


@pytest.fixture
def hovering(airframe):
    """In the air, a few metres up, rotors at hover thrust."""
    airframe.spin(True)
    airframe.command(0.0, 0.0, 0.0, 1.3 * airframe.hover_thrust_norm)
    run(airframe, 1.0)
    fly(airframe, 0.0, 0.0, 0.0, 0.5)
    return airframe


def test_at_rest_it_stays_and_its_accelerometer_reads_gravity(airframe):
    state = run(airframe, 3.0)
    assert state.position_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)
    assert state.euler_rad == pytest.approx((0.0, 0.0, 0.3), abs=1e-6)
    assert state.specific_force_frd_m_s2 == pytest.approx((0.0, 0.0, -GRAVITY_M_S2), abs=1e-3)
    assert state.motors_norm == (0.0, 0.0, 0.0, 0.0)


def test_without_lift_it_falls_freely(hovering):
    hovering.spin(False)
    before = run(hovering, 0.3)  # the rotors run down
    after = run(hovering, 0.1)
    gained_m_s = after.velocity_ned_m_s[2] - before.velocity_ned_m_s[2]
    drag_m_s2 = 0.54 * after.velocity_ned_m_s[2]
    assert gained_m_s / 0.1 == pytest.approx(GRAVITY_M_S2 - drag_m_s2, abs=0.5)
    assert abs(after.specific_force_frd_m_s2[2]) < 2.5


def test_at_hover_thrust_the_lift_is_the_weight(hovering):
    start = hovering.read()
    states = fly(hovering, 0.0, 0.0, 0.0, 4.0)
    assert sum(states[-1].motors_norm) / 4 == pytest.approx(hovering.hover_thrust_norm, rel=1e-3)
    # Only drag acts, so what is left of the climb dies away.
    assert abs(states[-1].velocity_ned_m_s[2]) < 0.15 * abs(start.velocity_ned_m_s[2])


@pytest.mark.parametrize(
    ("roll_rad", "pitch_rad", "forward", "right"),
    [(0.1, 0.0, 0.0, 1.0), (-0.1, 0.0, 0.0, -1.0), (0.0, 0.1, -1.0, 0.0), (0.0, -0.1, 1.0, 0.0)],
)
def test_tilting_accelerates_to_the_low_side(hovering, roll_rad, pitch_rad, forward, right):
    state = fly(hovering, roll_rad, pitch_rad, 0.0, 1.0)[-1]
    north, east, _ = state.velocity_ned_m_s
    c, s = math.cos(0.3), math.sin(0.3)
    along, across = c * north + s * east, c * east - s * north
    assert (along, across) == pytest.approx((0.7 * forward, 0.7 * right), abs=0.2)


@pytest.mark.parametrize("axis", [0, 1])
def test_attitude_steps_are_quick_and_do_not_overshoot(hovering, axis):
    setpoints = [0.0, 0.0]
    setpoints[axis] = 0.2
    angles = [state.euler_rad[axis] for state in fly(hovering, *setpoints, 0.0, 1.0)]
    reached_s = next(i for i, angle in enumerate(angles) if angle > 0.9 * 0.2) / HZ
    assert reached_s < 0.3
    assert max(angles) < 1.05 * 0.2
    assert angles[-1] == pytest.approx(0.2, rel=0.02)


def test_positive_yaw_rate_turns_clockwise_without_tilting(hovering):
    states = fly(hovering, 0.0, 0.0, 0.5, 2.0)
    rates = [state.rates_frd_rad_s[2] for state in states]
    assert max(rates) < 1.1 * 0.5
    assert rates[-1] == pytest.approx(0.5, rel=0.02)
    assert states[-1].euler_rad[2] > 0.3 + 0.8
    assert abs(states[-1].euler_rad[0]) < 1e-3
    front_right, rear_left, front_left, rear_right = states[5].motors_norm
    assert min(front_right, rear_left) > max(front_left, rear_right)


def test_drag_stops_it_as_measured_flights_were_stopped(hovering):
    fly(hovering, 0.0, -0.1, 0.0, 1.0)
    fly(hovering, 0.0, 0.0, 0.0, 0.5)
    before = math.hypot(*hovering.read().velocity_ned_m_s[:2])
    after = math.hypot(*fly(hovering, 0.0, 0.0, 0.0, 1.0)[-1].velocity_ned_m_s[:2])
    assert math.log(before / after) == pytest.approx(0.58, abs=0.06)  # 1/s, Engel et al. 2012


def test_wind_carries_it_along(hovering):
    hovering.set_wind((0.0, 2.0, 0.0))
    state = fly(hovering, 0.0, 0.0, 0.0, 8.0)[-1]
    assert state.velocity_ned_m_s[1] == pytest.approx(2.0, abs=0.1)


def test_a_push_accelerates_by_its_share_of_the_mass_whatever_the_heading(hovering):
    start = hovering.read().velocity_ned_m_s
    hovering.push((0.46, -0.23, 0.0))
    state = fly(hovering, 0.0, 0.0, 0.0, 0.2)[-1]
    gained = [after - before for before, after in zip(start, state.velocity_ned_m_s, strict=True)]
    assert gained[:2] == pytest.approx([0.2 * 1.0, 0.2 * -0.5], rel=0.08)
    hovering.push((0.0, 0.0, 0.0))
    coasting = fly(hovering, 0.0, 0.0, 0.0, 0.2)[-1]
    assert coasting.velocity_ned_m_s[0] < state.velocity_ned_m_s[0]


def test_the_loops_trim_out_a_weak_rotor(hovering):
    hovering.set_motor_efficiency(0, 0.8)
    state = fly(hovering, 0.0, 0.0, 0.0, 4.0)[-1]
    assert state.euler_rad[:2] == pytest.approx((0.0, 0.0), abs=0.02)


def test_position_is_the_integral_of_velocity_to_a_millimetre_over_ten_metres(hovering):
    start = hovering.read()
    north, east, down = start.position_ned_m
    before = start
    for state in fly(hovering, 0.05, -0.15, 0.0, 6.0):
        mean = [
            (a + b) / 2 / HZ
            for a, b in zip(before.velocity_ned_m_s, state.velocity_ned_m_s, strict=True)
        ]
        north, east, down = north + mean[0], east + mean[1], down + mean[2]
        before = state
    assert math.hypot(north, east) > 10.0
    assert before.position_ned_m == pytest.approx((north, east, down), abs=1e-3)


def test_thrust_beyond_the_rotors_saturates(hovering):
    hovering.command(0.0, 0.0, 0.0, 5.0)
    assert max(run(hovering, 0.5).motors_norm) == pytest.approx(1.0, abs=1e-3)


def test_a_fall_upside_down_ends_on_the_lid(hovering):
    hovering.command(3.0, 0.0, 0.0, 0.3)
    run(hovering, 1.0)
    hovering.spin(False)
    state = run(hovering, 6.0)
    assert -0.2 < -state.position_ned_m[2] < 0.2


def test_the_same_commands_give_the_same_states(airframe):
    other = Airframe("ardrone2", HZ, yaw_rad=0.3)
    for one in (airframe, other):
        one.spin(True)
        one.command(0.05, -0.1, 0.4, 0.7)
    assert run(airframe, 1.0) == run(other, 1.0)


def test_an_unknown_airframe_is_named_with_what_there_is():
    with pytest.raises(PlanError, match=r"airframe 'f450': no such aircraft; available: ardrone2"):
        Airframe("f450", HZ)


def test_nothing_is_printed(capfd):
    run(Airframe("ardrone2", HZ), 0.1)
    assert capfd.readouterr() == ("", "")
