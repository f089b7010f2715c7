"""Flights of preset best in lockstep: the vehicle's own motion tells how near the walls are."""

import numpy as np
import pytest

from companion.camera.logged import LoggedRecording
from companion.learn import Session

SHORT = ("experiment.initial_s=30", "experiment.learning_s=5", "experiment.test_s=5")


@pytest.fixture(scope="module")
def flown(fly_lockstep):
    return fly_lockstep(*SHORT, "learner.preset=best", "log.images=stereo")


@pytest.fixture(scope="module")
def percepts(flown):
    """By column, and whether the vehicle flew ahead."""
    columns = flown.log.columns("/percept")
    return columns | {"ahead": flown.log.columns("/decision")["state"] == "straight"}


def test_it_knows_most_of_the_way_ahead_and_nothing_before_it_has_learned(percepts):
    known = np.isfinite(percepts["motion_px"])
    assert not known[:50].any()
    later = np.arange(len(known)) > 200
    assert known[later & percepts["ahead"]].mean() > 0.5


def test_what_it_says_is_what_stereo_says(percepts):
    errors = percepts["motion_px"] / percepts["stereo_px"] - 1.0
    errors = errors[np.isfinite(errors)]
    assert np.abs(errors).mean() < 0.12


def test_the_estimate_is_the_surer_for_it(percepts):
    known = np.isfinite(percepts["motion_px"])
    ahead = percepts["ahead"] & (np.arange(len(known)) > 200)
    spread_px = percepts["mono_std_px"]
    assert np.median(spread_px[ahead & known]) < 0.6 * np.median(spread_px[ahead & ~known])


def test_the_papers_design_does_without(fly_lockstep):
    flown = fly_lockstep("experiment.initial_s=8", "experiment.learning_s=0", "experiment.test_s=0")
    assert np.isnan(flown.log.columns("/percept")["motion_px"]).all()


def test_a_log_teaches_what_its_flight_taught(flown, percepts):
    """Also by motion, as it holds what the autopilot told; only what is random differs."""
    session = Session(flown.plan)
    session.run([LoggedRecording(flown.log.path)])
    learning = np.arange(len(percepts["mono_px"])) < 350  # then the flight's learner was frozen
    scored = learning & np.isfinite(percepts["mono_px"]) & np.isfinite(percepts["stereo_px"])
    apart_px = session.scores.mono_px[: scored.sum()] - percepts["mono_px"][scored]
    moving = np.isfinite(percepts["motion_px"][scored])
    assert moving.sum() > 100
    assert np.abs(apart_px)[moving].mean() < 0.05
