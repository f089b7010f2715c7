"""External vision that jumps, comes late or is nonsense: what should not be believed is not."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.autopilot.estimation.vision_sample import VisionSample
from sitl.settings import SitlSettings
from sitl.simulator import World


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


def test_what_is_held_goes_along_with_a_jump(make_flight, make_mocap):
    """A client whose origin is elsewhere begins in flight: the vehicle stays, home does not."""
    mocap = make_mocap(make_flight())
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
def test_unusable_samples_change_nothing(make_flight, make_mocap, changes):
    flight, other = make_flight(), make_flight()
    flight.autopilot.set_parameter("EKF2_EV_QMIN", 50)
    mocap = make_mocap(flight)
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
def test_no_sample_makes_the_estimate_anything_but_a_number(make_hall, samples):
    hall = make_hall()
    world = World(hall, SitlSettings(), 1, hall)
    for sample in samples:
        world.autopilot.take_vision(sample)
        if sample.reset_counter % 2:
            world.advance_to(world.time_s + 0.02)
    world.advance_to(world.time_s + 0.1)
    estimate, quality = world.autopilot.estimate, world.autopilot.quality
    numbers = (*estimate.position_ned_m, *estimate.velocity_ned_m_s, estimate.yaw_rad)
    assert all(abs(number) < 1e5 for number in numbers)
    assert quality.level_deviation_m >= 0.0
