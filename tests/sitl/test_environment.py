"""Wind, gusts and ground: each is planted, and found again by what it does."""

import math

import numpy as np
import pytest

from sitl.environment.gusts import DrydenGusts, intensity
from sitl.environment.surroundings import ground_effect_norm
from sitl.faults import Faults
from sitl.injection import inject
from sitl.settings import SitlSettings

STEP_S = 0.02
CALM = (0.0, 0.0, 0.0)


def blown(w20_m_s, height_m, wind_ned_m_s, duration_s, seed=1):
    """(n, 3) gusts in NED at a vehicle that stays where it is."""
    gusts = DrydenGusts(np.random.default_rng(seed), STEP_S)
    steps = round(duration_s / STEP_S)
    return np.array([gusts.step(w20_m_s, height_m, wind_ned_m_s, CALM) for _ in range(steps)])


@pytest.mark.parametrize(("w20_m_s", "height_m"), [(7.7, 2.0), (15.0, 30.0)])
def test_gusts_have_the_mean_and_deviation_of_mil_f_8785c(w20_m_s, height_m):
    seen = np.concatenate([blown(w20_m_s, height_m, (5.0, 0.0, 0.0), 600, s) for s in (1, 2)])
    height_ft = max(10.0, height_m / 0.3048)
    vertical_m_s = 0.1 * w20_m_s
    level_m_s = vertical_m_s / (0.177 + 0.000823 * height_ft) ** 0.4
    assert np.std(seen, axis=0) == pytest.approx((level_m_s, level_m_s, vertical_m_s), rel=0.15)
    assert np.mean(seen, axis=0) == pytest.approx((0.0, 0.0, 0.0), abs=0.3 * level_m_s)


def test_gusts_are_remembered_for_as_long_as_their_length_takes_to_pass():
    """Of 1 / (1 + T s) the autocorrelation falls to 1/e after T, the length over the speed."""
    wind_m_s = 6.0
    along = np.concatenate([blown(7.7, 2.0, (wind_m_s, 0.0, 0.0), 900, s) for s in (1, 2, 3)])[:, 0]
    length_m = 10.0 * 0.3048 / (0.177 + 0.00823) ** 1.2
    assert intensity(7.7, 2.0).level_m == pytest.approx(length_m)
    steps = round(length_m / (wind_m_s + 0.6) / STEP_S)  # W20 blows a little harder than that
    correlation = np.mean(along[steps:] * along[:-steps]) / np.mean(along * along)
    assert correlation == pytest.approx(math.exp(-1), abs=0.12)


def test_the_strong_gusts_lie_along_the_wind():
    east = blown(7.7, 100.0, (0.0, 5.0, 0.0), 300)
    north = blown(7.7, 100.0, (5.0, 0.0, 0.0), 300)
    assert np.allclose(east[:, 1], north[:, 0])
    assert np.allclose(east[:, 0], -north[:, 1])


def test_the_same_seed_blows_the_same():
    assert np.array_equal(blown(7.7, 2.0, CALM, 5), blown(7.7, 2.0, CALM, 5))
    assert not np.array_equal(blown(7.7, 2.0, CALM, 5), blown(7.7, 2.0, CALM, 5, seed=2))


@pytest.mark.parametrize("way", ["plan", "parameter", "fault"])
def test_gusts_shake_the_vehicle_and_it_stays(make_flight, way):
    flight = make_flight(settings=SitlSettings(gusts_w20_m_s=5.0 if way == "plan" else 0.0))
    flight.take_off()
    place = flight.world.truth.position_ned_m
    if way == "parameter":
        assert flight.autopilot.set_parameter("SIM_WIND_GUST", 5.0)
    elif way == "fault":
        inject(flight.world, Faults(gusts_w20_m_s=5.0))
    first = len(flight.states)
    flight.run(20.0)
    speeds = [state.velocity_ned_m_s[0] for state in flight.states[first:]]
    assert 0.02 < np.std(speeds) < 0.5
    assert math.dist(flight.world.truth.position_ned_m, place) < 1.0


def test_gusts_of_the_same_seed_make_the_same_flight(make_flight):
    ends = []
    for seed in (1, 1, 2):
        flight = make_flight(settings=SitlSettings(gusts_w20_m_s=5.0), seed=seed)
        flight.take_off()
        ends.append(flight.world.truth)
    assert ends[0] == ends[1] != ends[2]


@pytest.mark.parametrize("strength", [1.0, 2.0])
def test_it_lands_and_disarms_in_gusts_and_ground_effect(make_flight, strength):
    flight = make_flight(settings=SitlSettings(gusts_w20_m_s=3.0, ground_effect_norm=strength))
    flight.take_off()
    flight.autopilot.land()
    flight.wait_until(lambda: not flight.status.armed, 20.0)
    assert flight.world.crashed is None
    assert -flight.world.truth.position_ned_m[2] < 0.1


def test_the_ground_lifts_as_cheeseman_and_bennett_say():
    assert ground_effect_norm(0.1, 0.1) == pytest.approx(16 / 15)
    assert ground_effect_norm(10.0, 0.1) == pytest.approx(1.0, abs=1e-5)
    assert ground_effect_norm(-1.0, 0.1) == ground_effect_norm(0.05, 0.1)


@pytest.mark.parametrize("way", ["plan", "parameter", "fault"])
def test_less_thrust_carries_it_near_the_ground(make_flight, way):
    """At 0.1 m over the floor, hubs at 0.158 m: 1 / (1 - (0.1 / 0.632)^2) is 2.6 % more."""
    strength = 2.0
    flight = make_flight(settings=SitlSettings(ground_effect_norm=strength if way == "plan" else 0))
    if way == "parameter":
        assert flight.autopilot.set_parameter("SIM_GND_EFFECT", strength)
    elif way == "fault":
        inject(flight.world, Faults(ground_effect_norm=strength))

    def thrust_norm(height_m):
        flight.autopilot.reposition((0.0, 0.0, -height_m), math.nan, math.nan)
        flight.run(8.0)
        first = len(flight.states)
        flight.run(4.0)
        states = flight.states[first:]
        lower_m = -np.mean([state.position_ned_m[2] for state in states]) - 0.05812
        return np.mean([state.motors_norm for state in states]), lower_m + 0.05812

    flight.take_off(1.0)
    high_norm, _ = thrust_norm(1.5)
    low_norm, hub_m = thrust_norm(0.12)
    expected = 1.0 + strength * (ground_effect_norm(hub_m, 0.1) - 1.0)
    assert high_norm / low_norm == pytest.approx(expected, abs=0.012)
    assert expected > 1.03
