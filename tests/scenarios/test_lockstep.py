"""Short flights on simulated time: what every flight must do, and that it can be repeated."""

import json
import math

import numpy as np
import pytest

SCHEMES = ("pure_stereo", "cold_turkey", "dagger", "training_wheels")
PHASES = (("initial", 10), ("learning", 8), ("test", 6))
TENTHS = [f"experiment.{phase}_s={duration_s}" for phase, duration_s in PHASES]
BRIEF = ["experiment.initial_s=3", "experiment.learning_s=3", "experiment.test_s=2"]
RATE_HZ = 10


@pytest.fixture(scope="module")
def flown(fly_lockstep):
    return fly_lockstep(*TENTHS)


def test_it_is_flown_without_touching_anything(flown):
    assert (flown.summary.outcome, flown.summary.reason) == ("flown", "")
    assert flown.summary.collisions == 0
    assert flown.summary.minimum_clearance_m > 0.1
    assert not flown.log.truncated


def test_it_lands(flown):
    last = flown.log.columns("/mocap")["truth_position_ned_m"][-1]
    assert last[2] == pytest.approx(0.0, abs=0.15)


def test_the_summary_has_every_figure(flown):
    summary = json.loads(flown.bytes_of("summary.json"))
    assert set(summary) >= {
        *("outcome", "collisions", "overrides", "turns", "approaches", "mse", "tpr", "fpr", "auc"),
        *("threshold_px", "stereo_flight_s", "mono_flight_s", "sim_s", "wall_s"),
        *("real_time_factor", "seed", "plan"),
    }
    assert (summary["plan"], summary["seed"]) == ("office", 1)
    assert summary["sim_s"] > 24.0
    assert summary["real_time_factor"] == pytest.approx(summary["sim_s"] / summary["wall_s"])
    flight_s = summary["stereo_flight_s"] + summary["mono_flight_s"]
    assert flight_s == pytest.approx(24.0, abs=0.11)  # the first frame has no duration


def test_the_summary_knows_how_far_it_flew(flown):
    summary = json.loads(flown.bytes_of("summary.json"))
    positions = flown.log.columns("/mocap")["truth_position_ned_m"]
    path_m = np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
    assert summary["distance_flown_m"] == pytest.approx(path_m)
    phases = summary["phases"].values()
    assert sum(phase["distance_flown_m"] for phase in phases) <= summary["distance_flown_m"]
    assert all(phase["cells_visited"] > 0 and phase["collisions"] == 0 for phase in phases)


def test_the_phases_come_in_order_and_last_as_planned(flown):
    phases = list(flown.log.columns("/decision")["phase"])
    assert phases == [phase for phase, duration_s in PHASES for _ in range(duration_s * RATE_HZ)]


def test_it_keeps_its_height_and_speed(flown):
    log = flown.log
    decisions, telemetry = log.columns("/decision"), log.columns("/telemetry")
    height_m = -telemetry["position_ned_m"][:, 2]
    assert np.abs(height_m - flown.plan.behaviour.height_m).max() < 0.15
    north, east, _ = telemetry["velocity_ned_m_s"].T
    straight = decisions["state"] == "straight"
    cruising = np.convolve(straight, np.ones(15), mode="full")[: len(straight)] == 15
    assert cruising.sum() > 20  # straight ahead for 1.5 s or longer
    assert np.median(np.hypot(north, east)[cruising]) == pytest.approx(0.5, abs=0.08)


def test_the_truth_is_where_the_plan_says(flown):
    log = flown.log
    stamps = log.columns("/percept")["stamp_ns"]
    mocap = log.columns("/mocap")
    flying = (mocap["stamp_ns"] >= stamps[0]) & (mocap["stamp_ns"] <= stamps[-1])
    height_m = -mocap["truth_position_ned_m"][flying, 2]
    assert np.abs(height_m - flown.plan.behaviour.height_m).max() < 0.15


def test_no_setpoint_leaves_the_limits(flown):
    safety = flown.plan.safety
    setpoints = flown.log.columns("/setpoint")
    forward, right, down = setpoints["velocity_hfrd_m_s"].T
    assert np.hypot(forward, right).max() <= safety.max_speed_m_s
    assert np.abs(down).max() <= safety.max_climb_m_s
    limit_rad_s = math.radians(safety.max_yaw_rate_deg_s)
    assert np.abs(setpoints["yaw_rate_rad_s"]).max() <= limit_rad_s


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_same_seed_gives_the_same_bytes(fly_lockstep, scheme):
    words = (*BRIEF, f"experiment.scheme={scheme}")
    one, other = fly_lockstep(*words), fly_lockstep(*words)
    for name in ("flight.mcap", "model.npz"):
        assert one.bytes_of(name) == other.bytes_of(name)


def test_the_best_preset_flies_and_repeats_itself_too(fly_lockstep):
    words = (*BRIEF, "learner.preset=best")
    one, other = fly_lockstep(*words), fly_lockstep(*words)
    for name in ("flight.mcap", "model.npz"):
        assert one.bytes_of(name) == other.bytes_of(name)
    assert np.isfinite(one.log.columns("/percept")["mono_px"][-RATE_HZ:]).all()


@pytest.mark.parametrize("regressor", ["blend", "gp", "mlp", "ridge"])
def test_every_regressor_flies(fly_lockstep, regressor):
    flown = fly_lockstep(
        *BRIEF,
        "learner.textons.training_images=10",
        "learner.preset=none",
        f"learner.regressor={regressor}",
    )
    assert np.isfinite(flown.log.columns("/percept")["mono_px"][-RATE_HZ:]).all()


def test_another_seed_flies_another_flight(fly_lockstep):
    logs = [fly_lockstep(*BRIEF, f"seed={seed}").log for seed in (1, 2)]
    one, other = (log.columns("/percept")["stereo_px"] for log in logs)
    assert not np.array_equal(one, other, equal_nan=True)


def test_learning_is_frozen_in_the_test_phase(fly_lockstep):
    lengths_s = (2, 5)
    short, long = (fly_lockstep(*BRIEF, f"experiment.test_s={test_s}") for test_s in lengths_s)
    assert long.summary.frames - short.summary.frames == 3 * RATE_HZ
    one, other = (np.load(flown.log_dir / "model.npz") for flown in (short, long))
    for name in set(one.files) - {"header.json"}:  # which tells how long it flew
        np.testing.assert_array_equal(one[name], other[name])
    assert short.summary.samples_learned == long.summary.samples_learned <= 6 * RATE_HZ


@pytest.mark.parametrize(
    ("scheme", "learning_cue"), [("cold_turkey", "stereo"), ("training_wheels", "mono")]
)
def test_the_scheme_says_who_flies(fly_lockstep, scheme, learning_cue):
    flown = fly_lockstep(*TENTHS, f"experiment.scheme={scheme}")
    decisions = flown.log.columns("/decision")
    own_choice = ~decisions["override"]
    for phase, cue in (("initial", "stereo"), ("learning", learning_cue), ("test", "mono")):
        cues = decisions["cue"][(decisions["phase"] == phase) & own_choice]
        assert set(cues) == {cue}


def test_the_risk_seen_so_far_sets_monos_threshold(fly_lockstep):
    words = ["experiment.initial_s=35", "experiment.learning_s=3", "experiment.test_s=2"]
    one, other = (fly_lockstep(*words, "learner.threshold=risk") for _ in range(2))
    fixed_px = one.plan.learner.fixed_threshold_px(one.plan.behaviour.turn_threshold_px)
    decisions = one.log.columns("/decision")
    flown_px = decisions["threshold_px"][decisions["cue"] == "mono"]
    assert len(flown_px)
    assert fixed_px not in flown_px  # stereo flew and met positives first
    assert flown_px[-1] == one.summary.threshold_px
    assert one.bytes_of("flight.mcap") == other.bytes_of("flight.mcap")


def test_with_maps_it_turns_to_the_freer_side_and_logs_what_it_saw(fly_lockstep):
    words = (*TENTHS, "learner.preset=best", "learner.output=map", "behaviour.turn_to=freer")
    flown = fly_lockstep(*words)
    assert flown.summary.collisions == 0
    maps, percepts = flown.log.columns("/map"), flown.log.columns("/percept")
    assert maps["disparity_px"].shape == (len(maps["stamp_ns"]), 48)
    known = np.isin(percepts["stamp_ns"], maps["stamp_ns"])
    assert np.isfinite(percepts["mono_px"][known]).all()
    assert np.mean(known) > 0.9
