"""What a flight is judged by, from invented frames."""

import math

import pytest

from companion.flying.switch import Choice
from companion.judging.scorecard import Scorecard
from companion.kernel.messages import BehaviourState, Cue, Percept, Phase

STRAIGHT, ROTATE = BehaviourState.STRAIGHT, BehaviourState.ROTATE


class Story:
    """Frames at 10 Hz, told one by one."""

    def __init__(self):
        self.card = Scorecard(positive_threshold_px=4.0)
        self.frames = 0

    def frame(
        self, state=STRAIGHT, cue=Cue.MONO, override=False, stereo=1.0, mono=1.0, caution_px=0.0
    ):
        percept = Percept(
            stamp_ns=self.frames * 100_000_000,
            stereo_px=stereo,
            stereo_valid_norm=1.0,
            mono_px=mono,
            mono_std_px=0.0,
        )
        choice = Choice(cue, override, mono, 4.0, False)
        self.frames += 1
        return self.card.record(percept, Phase.TEST, choice, state, 3.5, caution_px)


def test_turns_and_approaches_are_counted_where_they_begin():
    story = Story()
    for _ in range(3):
        for state in (STRAIGHT, STRAIGHT, ROTATE, ROTATE):
            account = story.frame(state)
    assert account.turns == 3
    assert account.approaches == account.mono_approaches == 3


def test_an_override_counts_once_per_approach_however_often_it_flickers():
    story = Story()
    for override in (False, True, False, True, True):
        story.frame(override=override)
    story.frame(ROTATE, override=True)
    account = story.frame(ROTATE, override=False)
    assert account.overrides == 1
    story.frame(STRAIGHT)
    assert story.frame(STRAIGHT, override=True).overrides == 2


def test_caution_is_part_of_what_was_detected_but_not_of_the_error():
    story = Story()
    for stereo_px, mono_px in ((5.0, 3.0), (5.0, 3.4), (1.0, 1.0), (2.0, 3.2)):
        account = story.frame(stereo=stereo_px, mono=mono_px, caution_px=0.4)
    score = account.score()
    assert (score.tpr, score.fpr) == (0.5, 0.5)
    assert score.mse == pytest.approx((4.0 + 1.6**2 + 1.2**2) / 4)
    assert account.approach_samples().mono_px.tolist() == pytest.approx([3.4, 3.8, 1.4, 3.6])


def test_flight_time_goes_to_the_cue_that_flew():
    story = Story()
    for _ in range(11):
        story.frame(cue=Cue.STEREO)
    for _ in range(20):
        account = story.frame(cue=Cue.MONO)
    assert account.stereo_flight_s == pytest.approx(1.0)
    assert account.mono_flight_s == pytest.approx(2.0)


def test_score_takes_stereo_as_truth_and_skips_frames_that_miss_a_cue():
    story = Story()
    for stereo, mono in [(5.0, 4.0), (5.0, 3.0), (1.0, 1.0), (1.0, 4.0), (math.nan, 9.0)]:
        account = story.frame(stereo=stereo, mono=mono)
    score = account.score()
    assert score.tpr == 0.5
    assert score.fpr == 0.5
    assert score.mse == pytest.approx((1 + 4 + 0 + 9) / 4)
    assert score.auc == pytest.approx(0.625)


def test_without_positives_the_true_positive_rate_is_unknown_not_zero():
    score = Story().frame().score()
    assert math.isnan(score.tpr)
    assert score.fpr == 0.0
