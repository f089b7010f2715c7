"""Who flies: schemes by phase (paper section V-A), and the override."""

import math

import numpy as np
import pytest

from companion.kernel.messages import Cue, Percept, Phase
from companion.switch import ExperimentSettings, Switch, Thresholds

THRESHOLDS = Thresholds(stereo_px=4.0, mono_px=3.5, override_px=5.0)


def percept(stereo_px, mono_px):
    return Percept(
        stamp_ns=0, stereo_px=stereo_px, stereo_valid_norm=1.0, mono_px=mono_px, mono_std_px=0.0
    )


def make(scheme, **settings):
    experiment = ExperimentSettings(scheme=scheme, **settings)
    return Switch(experiment, np.random.default_rng(0))


def choose(switch, stereo_px, mono_px, phase=Phase.TEST, looks_ahead=True):
    return switch.choose(percept(stereo_px, mono_px), phase, THRESHOLDS, looks_ahead)


@pytest.mark.parametrize(
    ("scheme", "initial", "learning", "test"),
    [
        ("pure_stereo", Cue.STEREO, Cue.STEREO, Cue.STEREO),
        ("cold_turkey", Cue.STEREO, Cue.STEREO, Cue.MONO),
        ("training_wheels", Cue.STEREO, Cue.MONO, Cue.MONO),
    ],
)
def test_each_scheme_flies_on_the_papers_cue(scheme, initial, learning, test):
    switch = make(scheme)
    cues = [choose(switch, 1.0, 1.0, phase).cue for phase in list(Phase)[:3]]
    assert cues == [initial, learning, test]


def test_dagger_mixes_by_frame_while_learning_and_flies_mono_after():
    switch = make("dagger", dagger_beta=0.25)
    learning = [choose(switch, 1.0, 1.0, Phase.LEARNING).cue for _ in range(4000)]
    assert np.mean([cue is Cue.STEREO for cue in learning]) == pytest.approx(0.25, abs=0.03)
    assert all(choose(switch, 1.0, 1.0, Phase.TEST).cue is Cue.MONO for _ in range(100))


def test_override_begins_above_its_threshold_and_lasts_until_stereo_is_clear():
    switch = make("training_wheels")
    assert not choose(switch, 4.9, 1.0).override
    begins = choose(switch, 5.1, 1.0)
    assert begins.override
    assert begins.cue is Cue.STEREO
    assert begins.blocked
    assert choose(switch, 4.5, 1.0).override
    assert choose(switch, math.nan, 1.0).override
    clear = choose(switch, 4.0, 1.0)
    assert not clear.override
    assert clear.cue is Cue.MONO


def test_no_override_while_mono_turns_away_by_itself():
    switch = make("training_wheels")
    assert not choose(switch, 6.0, 3.6).override
    assert not choose(switch, 6.0, 1.0, looks_ahead=False).override


def test_unknown_mono_falls_back_on_stereo_and_unknown_stereo_does_not_alarm():
    switch = make("training_wheels")
    fallback = choose(switch, 4.2, math.nan)
    assert (fallback.cue, fallback.override, fallback.blocked) == (Cue.STEREO, False, True)
    assert choose(switch, math.nan, 1.0).cue is Cue.MONO
    assert choose(switch, math.nan, math.nan).blocked is None


def test_phases_follow_each_other_at_the_planned_times():
    experiment = ExperimentSettings(initial_s=60, learning_s=240, test_s=300)
    times_s = (0.0, 59.9, 60.0, 299.9, 300.0, 599.9, 600.0)
    assert [experiment.phase_at(t) for t in times_s] == [
        Phase.INITIAL, Phase.INITIAL, Phase.LEARNING, Phase.LEARNING,
        Phase.TEST, Phase.TEST, Phase.DONE,
    ]  # fmt: skip


def test_without_test_override_mono_is_alone_once_learning_is_over():
    switch = make("training_wheels", test_override=False)
    assert choose(switch, 9.0, 1.0, Phase.LEARNING).override
    for stereo_px, mono_px, blocked in ((9.0, 1.0, False), (1.0, 3.6, True), (9.0, math.nan, None)):
        alone = choose(switch, stereo_px, mono_px)
        assert (alone.cue, alone.override, alone.blocked) == (Cue.MONO, False, blocked)
    assert not switch.overriding


def test_without_test_override_pure_stereo_still_flies_on_stereo():
    assert choose(make("pure_stereo", test_override=False), 9.0, 1.0).cue is Cue.STEREO
