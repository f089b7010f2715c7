"""An eye lost on a vehicle behind a real link: what a ground station hears of it."""

import pytest


@pytest.mark.flight(
    plan="office",
    speed=5,
    overrides=[f"experiment.{phase}_s=10" for phase in ("initial", "learning", "test")],
)
def test_the_loss_of_an_eye_reaches_the_ground_station_and_lands(sitl):
    sitl.inject(right_eye="black")
    summary = sitl.fly_plan()
    assert summary.outcome == "failed"
    assert summary.reason.startswith("landing: stereo is gone (right eye: black")
    sitl.wait_until_said("right eye: black; stopping")
    sitl.expect_no_collision()
    assert not sitl.telemetry.armed
