"""One flight as a user flies it: the simulator in its own process, through MAVSDK over UDP."""

import numpy as np


def test_it_flies_the_plan_and_lands(start_companion):
    durations = ("initial_s=6", "learning_s=5", "test_s=4")
    words = [word for text in durations for word in ("--set", f"experiment.{text}")]
    companion = start_companion("sitl", *words)
    code, lines = companion.wait()
    assert code == 0, lines
    summary, log = companion.leaves()
    assert (summary["outcome"], summary["collisions"]) == ("flown", 0)
    assert not log.truncated

    decisions, telemetry = log.columns("/decision"), log.columns("/telemetry")
    assert list(dict.fromkeys(decisions["phase"])) == ["initial", "learning", "test"]
    flown_s = (decisions["stamp_ns"][-1] - decisions["stamp_ns"][0]) * 1e-9
    assert 14.0 < flown_s <= 15.0
    height_m = -telemetry["position_ned_m"][:, 2]
    assert np.abs(height_m - 1.2).max() < 0.3
    mocap = log.columns("/mocap")
    assert abs(mocap["truth_position_ned_m"][-1, 2]) < 0.15
