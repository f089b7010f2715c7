"""The figures of flight quality: planted responses are found, and the vehicle flies well."""

import numpy as np
import pytest

from companion.kernel.errors import CompanionError
from tools.bench.quality import (
    EXACT,
    SAMPLE_S,
    SPEED_M_S,
    SPEED_TOLERANCE_M_S,
    Trial,
    step_response,
)


def test_a_planted_step_is_measured():
    """A damped oscillation: its overshoot and settling are known."""
    time_s = np.arange(0.0, 20.0, SAMPLE_S) + SAMPLE_S
    damping, hz = 0.5, 2.0
    swing = np.sqrt(1.0 - damping**2)
    phase = hz * swing * time_s
    series = 1.0 - np.exp(-damping * hz * time_s) * (
        np.cos(phase) + damping / swing * np.sin(phase)
    )
    found = step_response(series)
    assert found.overshoot_percent == pytest.approx(
        100.0 * np.exp(-np.pi * damping / swing), abs=0.5
    )
    assert found.rise_s == pytest.approx(0.82, abs=0.03)  # Franklin: 1.64 / natural frequency
    settled = np.abs(series[round(found.settling_s / SAMPLE_S) :] - 1.0)
    assert settled.max() <= 0.1


def test_a_step_that_is_not_followed_is_said():
    with pytest.raises(CompanionError, match="reached 50% of what was commanded"):
        step_response(np.full(100, 0.5))


@pytest.mark.parametrize("speed_m_s", [SPEED_M_S, -SPEED_M_S])
def test_half_a_metre_per_second_commanded_is_half_a_metre_per_second(speed_m_s):
    truth_m_s, _ = Trial().fly_north(12.0, speed_m_s)
    assert truth_m_s[100:].mean() == pytest.approx(speed_m_s, abs=SPEED_TOLERANCE_M_S)
    assert abs(truth_m_s[100:] - speed_m_s).max() < 0.06


def test_steps_are_followed_quickly_and_without_swinging():
    speed, turn = Trial().fly_north(4.0, 0.5)[0] / 0.5, Trial().turn(4.0, 0.8)[0] / 0.8
    for response in (step_response(speed), step_response(turn)):
        assert response.rise_s < 0.6
        assert response.overshoot_percent < 8.0
        assert response.settling_s < 1.0


def test_wind_carries_it_off_for_a_while_only():
    error_m = Trial(EXACT, (0.0, 5.0, 0.0)).hover()
    assert error_m.max() < 1.2
    assert error_m[-500:].max() < 0.05
