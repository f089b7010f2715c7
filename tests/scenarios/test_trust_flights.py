"""Flights by trust instead of by the clock, in lockstep: mono takes over, goes alone, or lands."""

import math

import numpy as np
import pytest

EASILY = [  # as much trust as a flight of a minute can earn
    *("trust.window_s=20", "trust.least_approaches=1", "trust.error_norm=9", "trust.auc=0.2"),
    *("trust.collision_probability=1", "trust.confirm_s=1", "trust.recent_error_norm=50"),
]
AUTO = [
    *("experiment.scheme=auto", "experiment.initial_s=15", "experiment.learning_s=15"),
    *("experiment.test_s=10", "learner.preset=none", "learner.textons.training_images=10"),
    *("learner.delay_frames=10", "behaviour.speed_by_certainty=true"),
]
OVER_AFTER_S = 30


@pytest.fixture(scope="module")
def alone(fly_lockstep):
    """Trusted within half a minute; then stereo is over."""
    return fly_lockstep(*AUTO, *EASILY, "experiment.test_override=false")


@pytest.fixture(scope="module")
def untrusted(fly_lockstep):
    """The same, but nothing so short earns trust."""
    return fly_lockstep(*AUTO, "experiment.test_override=false")


def seconds_of(flown):
    stamps_ns = flown.log.columns("/decision")["stamp_ns"]
    return (stamps_ns - stamps_ns[0]) * 1e-9


def test_mono_takes_over_when_it_is_trusted_and_not_by_the_clock(alone):
    decisions = alone.log.columns("/decision")
    trusted = decisions["trust"] == "trusted"
    first_s = seconds_of(alone)[trusted][0]
    assert alone.summary.outcome == "flown"
    assert first_s == pytest.approx(alone.summary.trusted_after_s)
    assert first_s < OVER_AFTER_S
    own_choice = ~decisions["override"]
    assert set(decisions["cue"][trusted & own_choice]) == {"mono"}
    assert set(decisions["cue"][~trusted]) == {"stereo"}
    assert set(decisions["phase"][trusted]) == {"test"}


def test_its_status_is_in_the_log_with_what_it_was_judged_by(alone):
    figures = alone.log.columns("/trust")
    assert list(dict.fromkeys(figures["status"])) == ["untrained", "learning", "trusted"]
    assert np.diff(figures["stamp_ns"]).min() >= 1_000_000_000
    last = {name: column[-1] for name, column in figures.items()}
    assert last["frames"] > 0
    assert not any(math.isnan(last[name]) for name in ("error_norm", "auc", "novelty"))
    assert any("mono is trusted" in text for text in alone.log.columns("/event")["text"])


def test_alone_it_flies_on_mono_without_override_or_learning(alone):
    decisions = alone.log.columns("/decision")
    over = seconds_of(alone) >= OVER_AFTER_S
    assert set(decisions["cue"][over]) == {"mono"}
    assert not decisions["override"][over].any()
    assert alone.summary.samples_learned <= OVER_AFTER_S * 10
    assert alone.summary.collisions == 0


def test_its_speed_follows_its_certainty(alone):
    behaviour = alone.plan.behaviour
    decisions = alone.log.columns("/decision")
    forward_m_s = alone.log.columns("/setpoint")["velocity_hfrd_m_s"][:, 0]
    ahead = (decisions["state"] == "straight") & (decisions["cue"] == "mono") & (forward_m_s > 0)
    certainty = decisions["certainty_norm"][ahead]
    span_m_s = behaviour.forward_speed_m_s - behaviour.speed_floor_m_s
    expected_m_s = behaviour.speed_floor_m_s + span_m_s * certainty
    np.testing.assert_allclose(forward_m_s[ahead], expected_m_s, atol=1e-9)
    assert certainty.min() < 0.9 < certainty.max()


def test_without_trust_it_stands_still_at_once_and_lands(untrusted):
    decisions = untrusted.log.columns("/decision")
    over = seconds_of(untrusted) >= OVER_AFTER_S
    assert untrusted.summary.outcome == "failed"
    assert untrusted.summary.reason == (
        "landing: stereo is gone, and the estimate of one eye is learning"
    )
    assert set(decisions["cue"][over]) == {"none"}
    setpoints = untrusted.log.columns("/setpoint")
    assert np.abs(setpoints["velocity_hfrd_m_s"][over][:, :2]).max() == 0.0
    assert over.sum() == pytest.approx(10 * untrusted.plan.safety.land_after_s, abs=2)
    assert untrusted.log.columns("/mocap")["truth_position_ned_m"][-1][2] == pytest.approx(
        0.0, abs=0.15
    )


def test_the_same_seed_gives_the_same_flight(fly_lockstep, untrusted):
    again = fly_lockstep(*AUTO, "experiment.test_override=false")
    assert again.bytes_of("flight.mcap") == untrusted.bytes_of("flight.mcap")


@pytest.mark.flight(
    plan="two_rooms",
    overrides=[
        "experiment.initial_s=15",
        "experiment.learning_s=0",
        "experiment.test_s=0",
        "behaviour.zone=[{from_s=0.0, centre_m=[5.6, 0.0], radius_m=1.8}]",
    ],
)
def test_a_zone_in_the_other_arena_is_reached_through_the_doorway(lockstep):
    summary = lockstep.fly_plan()
    assert (summary.outcome, summary.collisions) == ("flown", 0)
    north_m = [pose.truth_position_ned_m[0] for pose in lockstep.path]
    assert max(north_m) > 0.5 > 0.0 > min(north_m)
