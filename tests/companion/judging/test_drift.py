"""When the autopilot's estimate counts as drifting, and what is flown then."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.judging.drift import DriftMonitor, DriftSettings
from companion.kernel.frames import ned_from_hfrd
from companion.kernel.messages import Setpoint, Telemetry
from companion.vision.odometry import Motion

PERIOD_NS = 200_000_000
TOLD = Telemetry(position_ned_m=(1.0, 2.0, -1.2), velocity_ned_m_s=(0.5, 0.0, 0.0), yaw_rad=0.0)

speeds = st.floats(-0.5, 0.5)


def watch(monitor, excess, n, begin=0, noise=0.0, seed=0, told=(0.0, 0.0), scale=1.0):
    """``n`` measurements from the ``begin``-th on; all that was said.

    ``told``: by the autopilot; ``scale``: the camera's idea of a metre.
    """
    rng = np.random.default_rng(seed)
    said = []
    for number in range(begin, begin + n):
        monitor.corrected(TOLD, number * PERIOD_NS)
        truth = np.subtract([*told, 0.0], [*excess, 0.0])
        seen = truth * scale + rng.normal(0.0, noise, 3)
        said.append(monitor.judge(number * PERIOD_NS, Motion(np.array([*told, 0.0]), seen)))
    return said


def events(said):
    return [judgement.event.text for judgement in said if judgement.event]


def test_a_drift_is_named_within_three_seconds_and_only_once():
    monitor = DriftMonitor(DriftSettings())
    watch(monitor, (0.0, 0.0), 50, noise=0.05)
    said = watch(monitor, (0.2, 0.0), 50, begin=50, noise=0.03)
    assert len(events(said)) == monitor.n_named == 1
    assert next(n for n, judgement in enumerate(said) if judgement.event) * PERIOD_NS < 3e9
    assert events(said)[0].startswith("estimator: drifts by 0.")


def test_it_says_how_fast_and_whereto():
    monitor = DriftMonitor(DriftSettings())
    assert events(watch(monitor, (0.0, -0.2), 50)) == [
        "estimator: drifts by 0.20 m/s towards 270 deg; corrected"
    ]


def test_the_noise_of_a_healthy_flight_is_not_named():
    monitor = DriftMonitor(DriftSettings())
    assert events(watch(monitor, (0.02, -0.02), 5000, noise=0.06)) == []
    assert monitor.corrected(TOLD, 10**12) is TOLD
    assert monitor.compensated(Setpoint(stamp_ns=0), 0.0) == Setpoint(stamp_ns=0)


@pytest.mark.parametrize(("n_astray", "named"), [(15, 0), (40, 1)])
def test_what_scatters_about_the_limit_must_stay_above_it_for_a_while(n_astray, named):
    monitor = DriftMonitor(DriftSettings())
    watch(monitor, (0.0, 0.0), 20, noise=0.01)
    for number in range(20, 20 + n_astray):
        watch(monitor, (0.2 if number % 2 else 0.13, 0.0), 1, begin=number)
    watch(monitor, (0.0, 0.0), 20, begin=20 + n_astray, noise=0.01)
    assert monitor.n_named == named


def test_an_end_of_the_drift_is_told_and_what_was_walked_stays_corrected():
    monitor = DriftMonitor(DriftSettings())
    watch(monitor, (0.2, 0.0), 50)
    assert events(watch(monitor, (0.0, 0.0), 50, begin=50)) == [
        "estimator: velocity agrees with the camera again"
    ]
    healed = monitor.corrected(TOLD, 100 * PERIOD_NS)
    assert healed.velocity_ned_m_s == TOLD.velocity_ned_m_s
    assert healed.position_ned_m[0] < TOLD.position_ned_m[0] - 1.0


def test_between_the_two_limits_the_verdict_stays():
    monitor = DriftMonitor(DriftSettings())
    assert events(watch(monitor, (0.09, 0.0), 50)) == []
    watch(monitor, (0.2, 0.0), 50, begin=50)
    assert events(watch(monitor, (0.09, 0.0), 50, begin=100)) == []
    assert monitor.named


def test_measurements_that_contradict_each_other_name_nothing():
    """So it is while the telemetry is late and the vehicle turns now and then."""
    monitor = DriftMonitor(DriftSettings())
    assert events(watch(monitor, (0.3, 0.0), 500, noise=0.5)) == []


@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_a_camera_that_knows_its_scale_badly_names_no_drift(scale):
    """A nominal calibration: what it is wrong by turns with the vehicle."""
    monitor = DriftMonitor(DriftSettings())
    headings = np.radians([0.0, 100.0, 220.0, 330.0])
    for leg, heading in enumerate(headings):
        told = 0.5 * np.array([math.cos(heading), math.sin(heading)])
        fields = {"noise": 0.03, "scale": scale, "seed": leg}
        assert events(watch(monitor, (0.0, 0.0), 40, begin=60 * leg, told=told, **fields)) == []
        assert events(watch(monitor, (0.0, 0.0), 20, begin=60 * leg + 40, **fields)) == []


def test_such_a_camera_finds_a_drift_even_so():
    monitor = DriftMonitor(DriftSettings())
    ahead = {"told": (0.5, 0.0), "noise": 0.03, "scale": 0.8}
    watch(monitor, (0.0, 0.0), 50, **ahead)
    assert len(events(watch(monitor, (0.0, 0.2), 15, begin=50, **ahead))) == 1


def test_a_drift_from_the_start_is_found_when_the_vehicle_stands():
    """In flight ahead it might be the camera's scale."""
    monitor = DriftMonitor(DriftSettings())
    assert events(watch(monitor, (0.2, 0.0), 20, told=(0.5, 0.0))) == []
    assert len(events(watch(monitor, (0.2, 0.0), 15, begin=20))) == 1


def test_a_blind_camera_keeps_the_verdict():
    monitor = DriftMonitor(DriftSettings())
    watch(monitor, (0.2, 0.0), 50)
    late_ns = 1000 * PERIOD_NS
    assert monitor.judge(late_ns, None) == (None, None)
    assert monitor.corrected(TOLD, late_ns).velocity_ned_m_s == pytest.approx((0.3, 0.0, 0.0))


def test_the_position_loses_what_the_drift_adds_up_to():
    monitor = DriftMonitor(DriftSettings())
    watch(monitor, (0.2, -0.1), 50)
    before = monitor.corrected(TOLD, 50 * PERIOD_NS).position_ned_m
    later = monitor.corrected(TOLD, 100 * PERIOD_NS).position_ned_m
    assert np.subtract(later, before) == pytest.approx((-2.0, 1.0, 0.0))


def test_who_does_not_want_correction_is_told_only():
    monitor = DriftMonitor(DriftSettings(correct=False))
    assert events(watch(monitor, (0.2, 0.0), 50))[0].endswith("; not corrected")
    assert monitor.corrected(TOLD, 50 * PERIOD_NS) is TOLD
    setpoint = Setpoint(stamp_ns=0, velocity_hfrd_m_s=(0.5, 0.0, 0.0))
    assert monitor.compensated(setpoint, 1.0) is setpoint


@given(
    drift=st.tuples(speeds, speeds).filter(lambda v: math.hypot(*v) > 0.13),
    wanted=st.tuples(speeds, speeds, speeds),
    yaw_rad=st.floats(-math.pi, math.pi),
)
def test_the_vehicle_flies_what_was_wanted(drift, wanted, yaw_rad):
    """The autopilot makes its own, wrong velocity what it was asked for."""
    monitor = DriftMonitor(DriftSettings())
    watch(monitor, drift, 50)
    setpoint = Setpoint(stamp_ns=0, velocity_hfrd_m_s=wanted)
    asked = monitor.compensated(setpoint, yaw_rad)
    flown_ned = np.subtract(ned_from_hfrd(*asked.velocity_hfrd_m_s[:2], yaw_rad), drift)
    assert flown_ned == pytest.approx(ned_from_hfrd(*wanted[:2], yaw_rad), abs=1e-6)
    assert asked.velocity_hfrd_m_s[2] == wanted[2]


def test_a_record_a_second():
    said = watch(DriftMonitor(DriftSettings()), (0.2, 0.0), 58)
    records = [judgement.record for judgement in said if judgement.record]
    apart_s = np.diff([record.stamp_ns for record in records]) * 1e-9
    assert apart_s == pytest.approx([1.0] * 10)
    assert records[-1].velocity_ned_m_s == pytest.approx((0.2, 0.0))
    assert records[-1].named


def test_limits_that_exclude_each_other_are_refused():
    with pytest.raises(ValueError, match="clear_below_m_s must be below name_above_m_s"):
        DriftSettings(name_above_m_s=0.1, clear_below_m_s=0.1)
