"""Who flies: schemes by phase (paper section V-A), and the override."""

import math

import numpy as np
import pytest

from companion.flying.switch import ExperimentSettings, Switch, Thresholds
from companion.kernel.messages import Availability, Cue, Percept, Phase, TrustStatus

THRESHOLDS = Thresholds(stereo_px=4.0, mono_px=3.5, override_px=5.0)


def percept(stereo_px, mono_px, mono_std_px=0.0, mono_novelty=math.nan):
    return Percept(
        stamp_ns=0,
        stereo_px=stereo_px,
        stereo_valid_norm=1.0,
        mono_px=mono_px,
        mono_std_px=mono_std_px,
        mono_novelty=mono_novelty,
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


@pytest.mark.parametrize("trust", TrustStatus)
def test_auto_flies_on_mono_only_while_it_is_trusted(trust):
    switch = make("auto")
    phase = switch.settings.phase_at(10.0, trust)
    trusted = trust is TrustStatus.TRUSTED
    assert (phase is Phase.TEST) == trusted
    assert choose(switch, 1.0, 1.0, phase).cue is (Cue.MONO if trusted else Cue.STEREO)
    assert choose(switch, 9.0, 1.0, phase).override == trusted


def test_auto_ends_when_the_durations_have_passed_whatever_its_trust():
    experiment = ExperimentSettings(scheme="auto", initial_s=1, learning_s=2, test_s=3)
    for trust in TrustStatus:
        assert experiment.phase_at(5.9, trust) is not Phase.DONE
        assert experiment.phase_at(6.0, trust) is Phase.DONE


def test_auto_can_be_told_to_do_without_stereo_after_a_time():
    experiment = ExperimentSettings(scheme="auto", initial_s=1, learning_s=2, test_override=False)
    assert [experiment.stereo_is_over(t) for t in (0.0, 2.9, 3.0)] == [False, False, True]
    paper = ExperimentSettings(initial_s=1, learning_s=2, test_override=False)
    assert not paper.stereo_is_over(9.0)


@pytest.mark.parametrize("scheme", ["pure_stereo", "training_wheels", "auto"])
@pytest.mark.parametrize("trust", TrustStatus)
@pytest.mark.parametrize("eyes", [(True, True), (True, False), (False, True), (False, False)])
def test_without_stereo_only_an_eye_whose_estimate_is_trusted_flies(scheme, trust, eyes):
    available = Availability(False, *eyes)
    choice = make(scheme).choose(percept(9.0, 1.0), Phase.TEST, THRESHOLDS, True, available, trust)
    if trust is TrustStatus.TRUSTED and any(eyes):
        assert (choice.cue, choice.override, choice.blocked) == (Cue.MONO, False, False)
    else:
        assert (choice.cue, choice.override, choice.blocked) == (Cue.NONE, False, None)


def test_caution_adds_the_spread_of_the_estimate():
    cautious = THRESHOLDS._replace(caution_std=2.0)
    switch = make("training_wheels")
    for std_px, blocked in ((0.2, False), (0.6, True)):
        seen = percept(1.0, 2.5, std_px)
        assert switch.choose(seen, Phase.TEST, cautious, True).blocked is blocked
    assert not switch.choose(percept(9.0, 2.5, 0.6), Phase.TEST, cautious, True).override


def test_what_is_too_novel_counts_as_blocked():
    wary = THRESHOLDS._replace(novelty=1.5)
    switch = make("training_wheels")
    for novelty, blocked in ((1.4, False), (1.6, True), (math.nan, False)):
        seen = percept(1.0, 1.0, mono_novelty=novelty)
        assert switch.choose(seen, Phase.TEST, wary, True).blocked is blocked


def test_fused_flies_on_both_cues_after_the_initial_phase():
    switch = make("fused")
    seen = Percept(
        stamp_ns=0, stereo_px=4.5, stereo_valid_norm=0.5, mono_px=1.0, mono_std_px=0.5,
        fused_px=3.0, fused_std_px=0.3,
    )  # fmt: skip
    wanted = {Phase.INITIAL: (Cue.STEREO, True), Phase.TEST: (Cue.FUSED, False)}
    for phase, (cue, blocked) in wanted.items():
        choice = switch.choose(seen, phase, THRESHOLDS, True)
        assert (choice.cue, choice.blocked, choice.override) == (cue, blocked, False)


@pytest.mark.parametrize("trust", TrustStatus)
def test_without_test_override_mono_needs_neither_stereo_nor_trust(trust):
    switch = make("training_wheels", test_override=False)
    no_pair = Availability(stereo=False, left=True, right=True)
    seen = percept(9.0, 1.0), Phase.TEST, THRESHOLDS, True
    assert switch.choose(*seen, no_pair, trust).cue is Cue.MONO
    no_eye = Availability(stereo=False, left=False, right=False)
    assert switch.choose(*seen, no_eye, trust).cue is Cue.NONE
