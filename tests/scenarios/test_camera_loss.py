"""Eyes that fail in flight, in the office: who flies on, who lands, and who learns."""

import numpy as np
import pytest

from companion.kernel.messages import Event

PHASES = ["experiment.initial_s=15", "experiment.learning_s=20", "experiment.test_s=25"]
EAGER = [  # so that a flight of a minute shows what a flight of ten would
    *("learner.threshold_ratio=0.87", "trust.least_approaches=1", "trust.confirm_s=0"),
    *("trust.auc=0", "trust.collision_probability=1", "trust.error_norm=100"),
    *("trust.recent_error_norm=100", "trust.novelty=100"),
]
LOST_S = 50.0


def faults(**by_time):
    """``at_50={...}``: an override of ``sitl.events``."""
    tables = (
        "{" + ", ".join([f"at_s = {float(time[3:])}", *(f'{k} = "{v}"' for k, v in what.items())])
        + "}"
        for time, what in by_time.items()
    )  # fmt: skip
    return f"sitl.events=[{', '.join(tables)}]"


def events(flown):
    """What was said of the cameras."""
    said = flown.log.read("/event", Event)
    return [event for event in said if not event.text.startswith("mono is ")]


def texts(flown):
    return [event.text for event in events(flown)]


def after(flown, time_s, topic="/decision"):
    columns = flown.log.columns(topic)
    late = flown.log.log_times_ns(topic) * 1e-9 > time_s
    return {name: values[late] for name, values in columns.items()}


@pytest.mark.parametrize(("lost", "left_over"), [("right", "left"), ("left", "right")])
def test_one_eye_flies_on_with_what_was_learned(fly_lockstep, lost, left_over):
    flown = fly_lockstep(*PHASES, *EAGER, faults(at_50={f"{lost}_eye": "black"}))
    assert (flown.summary.outcome, flown.summary.collisions) == ("flown", 0)
    assert any(
        text.startswith(f"{lost} eye: black; flying on the {left_over} eye")
        for text in texts(flown)
    )
    decisions = after(flown, LOST_S + 0.5)
    assert set(decisions["cue"]) == {"mono"}
    assert not decisions["override"].any()
    assert np.isnan(after(flown, LOST_S, "/percept")["stereo_px"]).all()
    forward_m_s = after(flown, LOST_S + 0.5, "/setpoint")["velocity_hfrd_m_s"][:, 0]
    assert forward_m_s.max() > 0.2


@pytest.mark.parametrize(
    ("when", "what"),
    [
        ("at_15", {"right_eye": "frozen"}),  # before the dictionary is complete
        ("at_15", {"stereo_pair": "swapped"}),
        ("at_50", {"left_eye": "black", "right_eye": "saturated"}),  # after learning
    ],
    ids=["untrained", "unmatched", "both"],
)
def test_without_an_eye_to_fly_on_it_stops_holds_and_lands(fly_lockstep, when, what):
    preset = EAGER if when == "at_50" else []
    flown = fly_lockstep(*PHASES, *preset, faults(**{when: what}))
    assert flown.summary.outcome == "failed"
    assert flown.summary.reason.startswith("landing: stereo is gone (")
    assert flown.summary.collisions == 0
    lost_s = float(when[3:])
    assert set(after(flown, lost_s + 0.5)["cue"]) == {"none"}
    setpoints = after(flown, lost_s + 0.5, "/setpoint")
    assert not setpoints["velocity_hfrd_m_s"][:, :2].any()
    modes = after(flown, lost_s + 2.7, "/telemetry")["flight_mode"]
    assert set(modes) == {"hold"}
    assert after(flown, lost_s, "/mocap")["truth_position_ned_m"][-1, 2] == pytest.approx(
        0, abs=0.2
    )


def test_stereo_that_comes_back_flies_again_once_it_agrees(fly_lockstep):
    flown = fly_lockstep(
        *(*PHASES, *EAGER, "behaviour.forward_speed_m_s=0.2"),
        faults(at_40={"right_eye": "dirty"}, at_44={"right_eye": "none"}),
    )
    assert (flown.summary.outcome, flown.summary.collisions) == ("flown", 0)
    said = texts(flown)
    assert [text.partition(" (")[0] for text in said][:2] == [
        "right eye: contrast lost; flying on the left eye",
        "right eye: well again",
    ]
    assert said[2].startswith("flying on stereo again (")
    last = after(flown, 60.0, "/percept")
    assert np.isfinite(last["stereo_px"]).mean() > 0.9


def test_a_camera_that_falls_silent_is_named_and_ends_the_flight(fly_lockstep):
    flown = fly_lockstep(*PHASES, faults(at_20={"stereo_pair": "no_frames"}))
    assert flown.summary.reason.startswith("no new frame for 5.")
    event = events(flown)[0]
    assert event.text.startswith("camera: no frames; stopping")
    assert event.stamp_ns * 1e-9 - 20.0 <= 0.5


def test_eyes_that_do_not_match_teach_nothing(fly_lockstep):
    sound = fly_lockstep(*PHASES, *EAGER, faults(at_40={"left_eye": "none"}))
    swapped = fly_lockstep(*PHASES, *EAGER, faults(at_40={"stereo_pair": "swapped"}))
    percepts = sound.log.columns("/percept")
    estimated = np.isfinite(percepts["mono_px"] + percepts["stereo_px"])
    n_before = int(estimated[percepts["stamp_ns"] < 40.05e9].sum())
    assert swapped.summary.samples_learned == n_before + 1  # the first made the first estimate
    assert swapped.summary.samples_learned < sound.summary.samples_learned


def test_a_flight_with_faults_repeats_itself_to_the_byte(fly_lockstep):
    words = (*PHASES, faults(at_15={"left_eye": "torn"}, at_16={"left_eye": "none"}))
    one, other = fly_lockstep(*words), fly_lockstep(*words)
    assert one.bytes_of("flight.mcap") == other.bytes_of("flight.mcap")
