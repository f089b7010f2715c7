"""The plans that ship beside the paper's own, flown in lockstep as a mission test flies them."""

import math

import pytest

from companion.flightlog import FlightLog

SHORT = [f"experiment.{phase}_s=12" for phase in ("initial", "learning", "test")]


@pytest.mark.flight(plan="hover")
def test_hover_stays_where_it_took_off(lockstep):
    summary = lockstep.fly_plan()
    assert (summary.outcome, summary.turns) == ("flown", 0)
    assert summary.stereo_flight_s == pytest.approx(20.0, abs=0.2)
    assert max(math.hypot(*pose.truth_position_ned_m[:2]) for pose in lockstep.path) < 0.5
    assert not lockstep.telemetry.armed


@pytest.mark.flight(plan="corridor", overrides=SHORT)
def test_the_corridor_is_flown_without_touching_it(lockstep):
    summary = lockstep.fly_plan()
    assert (summary.outcome, summary.collisions) == ("flown", 0)
    lockstep.expect_clearance_m(0.1)
    north_m = [pose.truth_position_ned_m[0] for pose in lockstep.path]
    assert max(north_m) - min(north_m) > 2.0


@pytest.mark.flight(plan="battery_failsafe")
def test_an_empty_battery_ends_the_flight_on_the_ground(lockstep):
    summary = lockstep.fly_plan()
    assert summary.outcome == "failed"
    assert summary.reason == "the autopilot left offboard mode: hold"
    warned_s, landed_s = map(
        lockstep.wait_until_said, ("Critical battery level", "Landing detected")
    )
    assert 0.0 < landed_s - warned_s < 15.0
    assert lockstep.wait_until_disarmed() < 60.0
    lockstep.expect_no_collision()
    charge_norm = FlightLog(lockstep.evidence.folder / "flight.mcap").columns("/telemetry")[
        "battery_norm"
    ]
    assert charge_norm[0] > 0.1
    assert charge_norm[-1] < 0.071
