"""Wind that comes and goes while the vehicle hovers in the office."""

import numpy as np
import pytest

PLAN = (
    "behaviour.forward_speed_m_s=0",
    "experiment.initial_s=12",
    "experiment.learning_s=0",
    "experiment.test_s=0",
)
GUST_S = (16.0, 18.0)
GUST = (
    f"sitl.events=[{{at_s = {GUST_S[0]}, wind_ned_m_s = [4.0, 0.0, 0.0]}},"
    f" {{at_s = {GUST_S[1]}, wind_ned_m_s = [0.0, 0.0, 0.0]}}]"
)


@pytest.fixture(scope="module")
def carried_m(fly_lockstep):
    """``carried_m("push_back.gain_norm=0")``: how far north of where it was, at most."""

    def fly(*overrides):
        pose = fly_lockstep(*PLAN, GUST, *overrides).log.columns("/mocap")
        time_s, north_m = pose["stamp_ns"] * 1e-9, pose["truth_position_ned_m"][:, 0]
        blown = (time_s > GUST_S[0]) & (time_s < GUST_S[1] + 2.0)
        return np.abs(north_m[blown] - north_m[blown][0]).max()

    return fly


def test_a_gust_carries_it_half_as_far_as_the_autopilot_alone_lets_it(carried_m):
    assert carried_m() < 0.6 * carried_m("push_back.gain_norm=0")


def test_a_vehicle_that_sees_nothing_is_asked_to_stand_still_in_a_gust_too(fly_lockstep):
    blind = f'{{at_s = {GUST_S[0] - 1.0}, left_eye = "black", right_eye = "black"}}'
    flown = fly_lockstep(*PLAN, GUST.replace("[{", f"[{blind}, {{", 1))
    setpoint = flown.log.columns("/setpoint")
    gust = setpoint["stamp_ns"] * 1e-9 > GUST_S[0]
    assert gust.sum() > 10
    assert not setpoint["velocity_hfrd_m_s"][gust, :2].any()
