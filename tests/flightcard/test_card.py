"""The same flight card on both vehicles."""

import math

import pytest

from companion.kernel.errors import PlanError, VehicleError
from companion.kernel.messages import FlightMode
from flightcard import NotMetError


@pytest.fixture(params=["lockstep", "sitl"])
def vehicle(request):
    return request.getfixturevalue(request.param)


@pytest.mark.flight(speed=10)
def test_a_flight_by_verbs(vehicle):
    vehicle.arm()
    assert vehicle.telemetry.armed
    vehicle.take_off(1.2)
    vehicle.wait_until_hovering()
    vehicle.fly_velocity(3.0, forward_m_s=0.5)
    vehicle.wait_until_hovering()
    north_m = vehicle.path[-1].truth_position_ned_m[0]
    assert north_m == pytest.approx(1.5, abs=0.4)
    vehicle.expect_clearance_m(1.5)
    vehicle.expect_no_collision()
    vehicle.inject(wind_ned_m_s=(0.0, 3.0, 0.0))
    vehicle.run(3.0)
    assert vehicle.telemetry.roll_rad < -math.radians(1.0)  # leans into the wind
    vehicle.inject(wind_ned_m_s=(0.0, 0.0, 0.0))
    vehicle.land()
    assert not vehicle.telemetry.armed
    assert "Takeoff detected" in vehicle.texts


def test_time_from_cause_to_reaction(lockstep):
    lockstep.take_off(1.2)
    injected_s = lockstep.inject(charge_norm=0.06)
    said_s = lockstep.wait_until_said("Critical battery level", limit_s=1.0)
    holding_s, landing_s = (
        lockstep.wait_until(lambda now, mode=mode: now.flight_mode is mode, 6.0, mode.value)
        for mode in (FlightMode.HOLD, FlightMode.LAND)
    )
    assert 0.0 <= said_s - injected_s <= 0.021  # a period of the autopilot's
    assert 0.0 <= holding_s - injected_s <= 0.11  # one of the camera's
    assert 5.0 <= landing_s - injected_s <= 5.11  # COM_FAIL_ACT_T: time for a pilot to take over


@pytest.mark.flight(seed=3)
class TestSeveralVehicles:
    def test_the_same_seed_flies_the_same_path(self, make_lockstep):
        paths = []
        for seed in (3, 3, 4):
            vehicle = make_lockstep(seed=seed)
            vehicle.take_off(1.0)
            vehicle.fly_velocity(2.0, right_m_s=0.5, yaw_rate_rad_s=0.3)
            paths.append(vehicle.path)
        assert paths[0] == paths[1]
        assert paths[0] != paths[2]

    @pytest.mark.flight(speed=10)
    def test_one_hovers_while_the_other_flies(self, make_sitl, make_lockstep):
        one, other = make_sitl(), make_lockstep(speed=1)
        one.take_off(1.0)
        other.take_off(1.5)
        other.fly_velocity(1.0, forward_m_s=0.5)
        one.wait_until_hovering()
        one.land()
        assert not one.telemetry.armed
        assert other.telemetry.armed
        assert one.evidence.folder != other.evidence.folder


@pytest.mark.flight(faults={"motor_efficiency_norm": (1, 1, 1, 0.6)})
def test_faults_from_the_start(lockstep, make_lockstep):
    """The weak rotor has to be spun up by the controller: it turns on the way up."""
    lockstep.take_off(1.0)
    sound = make_lockstep(faults={})
    sound.take_off(1.0)
    worst_rad = [max(abs(pose.truth_ned_from_frd[3]) for pose in v.path) for v in (lockstep, sound)]
    assert worst_rad[0] > 2 * worst_rad[1]


def test_what_is_not_met_says_when_and_where(lockstep):
    lockstep.take_off(1.0)
    with pytest.raises(
        NotMetError, match=r"^not told 'Nonsense' within 2 s; now armed, hold, in_air, "
    ):
        lockstep.wait_until_said("Nonsense", limit_s=2.0)
    with pytest.raises(
        NotMetError, match=r"^clearance of 5 m not kept: 2\.\d\d m at \d+\.\d\d s, "
    ):
        lockstep.expect_clearance_m(5.0)


def test_a_refusal_is_the_autopilots(lockstep):
    lockstep.take_off(1.0)
    with pytest.raises(VehicleError, match=r"^take off: temporarily_rejected by the autopilot"):
        lockstep.take_off(1.0)


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        ({"sped": 3}, "flight: sped: unknown key; did you mean 'speed'?"),
        ({"room": "nowhere"}, "flight: nowhere: no such file; looked for "),
        ({"faults": {"motor_efficiency_norm": [1, 1, 1, 2]}}, "faults.motor_efficiency_norm"),
        ({"sitl": {"wind": 3}}, "sitl: wind: unknown key"),
    ],
)
def test_a_wrong_wish_is_refused(make_lockstep, wish, said):
    with pytest.raises(PlanError) as caught:
        make_lockstep(**wish)
    assert said in str(caught.value)


@pytest.mark.flight(faults={"link_loss_norm": 0.3, "link_latency_s": 0.3})
def test_a_bad_link_delays_but_does_not_end_a_flight(vehicle):
    vehicle.take_off(1.2)
    vehicle.fly_velocity(3.0, forward_m_s=0.5)
    vehicle.inject(link_loss_norm=0.0, link_latency_s=0.0)
    vehicle.wait_until_hovering()
    vehicle.expect_no_collision()
    vehicle.land()
