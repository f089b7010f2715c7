"""An autopilot whose velocity goes wrong in flight, in a room of 5 m."""

from pathlib import Path

import numpy as np
import pytest

from companion.kernel.messages import Event
from flightcard.flown import fly_in_lockstep

PLAN = Path(__file__).parents[2] / "flightplans" / "room1.toml"
PHASES = ["experiment.initial_s=10", "experiment.learning_s=20", "experiment.test_s=20"]
FAULT = "sitl.events=[{at_s = 20.0, estimator_drift_ned_m_s = [0.2, 0.0, 0.0]}]"


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    return fly_in_lockstep(PLAN, [*PHASES, FAULT], tmp_path_factory.mktemp("drift"))


def test_the_plan_is_flown_without_touching_a_wall(flown):
    assert (flown.summary.outcome, flown.summary.collisions) == ("flown", 0)


def test_the_drift_is_named_within_four_seconds(flown):
    said = [
        event
        for event in flown.log.read("/event", Event)
        if event.text.startswith("estimator: drifts by")
    ]
    assert len(said) == 1
    assert 20.0 < said[0].stamp_ns * 1e-9 < 24.0


def test_what_was_found_is_what_was_planted(flown):
    columns = flown.log.columns("/drift")
    found = columns["velocity_ned_m_s"][columns["named"].astype(bool)]
    assert len(found) > 20
    assert np.median(found, axis=0) == pytest.approx((0.2, 0.0), abs=0.03)


def test_the_same_flight_uncorrected_ends_early_or_at_a_wall(tmp_path):
    told_only = fly_in_lockstep(PLAN, [*PHASES, FAULT, "drift.correct=false"], tmp_path)
    summary = told_only.summary
    assert summary.outcome == "failed" or summary.collisions > 0


def test_a_healthy_flight_is_not_touched(tmp_path_factory):
    flights = [
        fly_in_lockstep(PLAN, [*PHASES, f"drift.correct={correct}"], tmp_path_factory.mktemp("x"))
        for correct in ("true", "false")
    ]
    for flown in flights:
        assert not any(e.text.startswith("estimator:") for e in flown.log.read("/event", Event))
    asked = [flown.log.columns("/setpoint")["velocity_hfrd_m_s"] for flown in flights]
    assert np.array_equal(*asked)
