"""When the learned estimate is trusted: the table of its status, and planted flights."""

import itertools
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.judging.risk import Approach
from companion.judging.trust import TrustMonitor, TrustSettings, due_status
from companion.kernel.messages import BehaviourState, Percept, TrustFigures, TrustStatus

UNTRAINED, LEARNING, TRUSTED, STALE = TrustStatus
STRAIGHT, ROTATE = BehaviourState.STRAIGHT, BehaviourState.ROTATE
RATE_HZ = 10
APPROACH = Approach(
    rate_hz=RATE_HZ, speed_m_s=0.5, disparity_metre_px=7.0, positive_threshold_px=4.0
)
SETTINGS = TrustSettings()
GOOD = TrustFigures(
    stamp_ns=0,
    status=LEARNING,
    frames=900,
    approaches=12,
    error_norm=0.2,
    recent_error_norm=0.3,
    auc=0.99,
    collision_probability=0.001,
    novelty=0.5,
)
MISSES = {"error_norm": 1.1, "recent_error_norm": 1.5, "auc": 0.79, "collision_probability": 0.41}
"""Each misses its limit by more than the slack."""
DOUBTS = {"error_norm": 0.9, "recent_error_norm": 1.0, "auc": 0.88, "collision_probability": 0.3}
"""Each misses its limit, but not by the slack."""


def figures(status, **changes):
    return msgspec.structs.replace(GOOD, status=status, **changes)


def due(status, has_truth=True, **changes):
    return due_status(figures(status, **changes), SETTINGS, has_truth)


@pytest.mark.parametrize(
    ("status", "has_truth", "changes", "then"),
    [
        (UNTRAINED, True, {"frames": 0}, UNTRAINED),
        (UNTRAINED, True, {}, LEARNING),
        (LEARNING, True, {}, TRUSTED),
        (LEARNING, False, {}, LEARNING),
        (LEARNING, True, {"approaches": 7}, LEARNING),
        (LEARNING, True, {"novelty": 9.0}, TRUSTED),
        (TRUSTED, True, {}, TRUSTED),
        (TRUSTED, True, {"novelty": 9.0}, TRUSTED),
        (TRUSTED, False, {"novelty": 9.0}, STALE),
        (TRUSTED, False, {"novelty": math.nan}, TRUSTED),
        (STALE, True, {}, TRUSTED),
        (STALE, False, {}, STALE),
    ],
)
def test_the_status_goes_one_step_at_a_time(status, has_truth, changes, then):
    assert due(status, has_truth, **changes) is then


@pytest.mark.parametrize("name", MISSES)
@pytest.mark.parametrize("status", [LEARNING, STALE])
def test_every_figure_must_be_known_and_good_to_earn_trust(status, name):
    for value in (DOUBTS[name], MISSES[name], math.nan):
        assert due(status, **{name: value}) is status


@pytest.mark.parametrize("name", MISSES)
def test_with_few_approaches_to_obstacles_only_the_error_takes_trust(name):
    kept = name in ("auc", "collision_probability")
    status = due(TRUSTED, approaches=7, **{name: MISSES[name]})
    assert status is (TRUSTED if kept else STALE)


@pytest.mark.parametrize("name", MISSES)
def test_trust_once_given_outlasts_doubts_but_not_misses(name):
    assert due(TRUSTED, **{name: DOUBTS[name]}) is TRUSTED
    assert due(TRUSTED, **{name: math.nan}) is TRUSTED
    assert due(TRUSTED, **{name: MISSES[name]}) is STALE
    assert due(TRUSTED, has_truth=False, **{name: MISSES[name]}) is TRUSTED


class Story:
    """Approaches at 10 Hz: 6 s straight towards a wall, λ rising to 5 px, then a turn of 2 s."""

    def __init__(self, **settings):
        self.monitor = TrustMonitor(
            TrustSettings(**settings), APPROACH, 1.0, np.random.default_rng(0)
        )
        self.frames = 0
        self.statuses = []

    def fly(self, n_approaches, estimate, truth=True, novelty=0.5, caution_px=0.0):
        self.caution_px = caution_px
        for _ in range(n_approaches):
            for frame in range(80):
                stereo_px = 1.0 + 4.0 * frame / 60 if frame < 60 else 2.0
                state = STRAIGHT if frame < 58 else ROTATE
                self._frame(stereo_px, estimate(stereo_px, self.frames), state, truth, novelty)
        return self.monitor.status

    def _frame(self, stereo_px, mono_px, state, truth, novelty):
        percept = Percept(
            stamp_ns=self.frames * 1_000_000_000 // RATE_HZ,
            stereo_px=stereo_px if truth else math.nan,
            stereo_valid_norm=1.0,
            mono_px=mono_px,
            mono_std_px=0.2,
            mono_novelty=novelty,
        )
        self.monitor.update(percept, state, 3.5, truth, self.caution_px)
        self.frames += 1
        self.statuses.append(self.monitor.status)


def nothing(stereo_px, frame):
    return math.nan


def good(stereo_px, frame):
    return stereo_px + 0.2 * math.sin(frame)


def low(stereo_px, frame):
    return stereo_px - 1.2 + 0.1 * math.sin(frame)


def test_who_is_cautious_runs_less_risk():
    bold, cautious = Story(), Story()
    for story, caution_px in ((bold, 0.0), (cautious, 1.0)):
        story.fly(12, low, caution_px=caution_px)
    risks = [story.monitor.figures.collision_probability for story in (bold, cautious)]
    assert risks[1] < 0.5 * risks[0]
    assert bold.monitor.figures.error_norm == cautious.monitor.figures.error_norm


def blind(stereo_px, frame):
    """What a learner answers in a room it does not know: the mean of the one it knows."""
    return 2.5 + 0.3 * math.sin(frame)


def wrong(stereo_px, frame):
    """One that calls a clear way blocked."""
    return 5.0


def test_an_estimate_earns_trust_by_flying_well():
    story = Story()
    assert story.fly(2, nothing) is UNTRAINED
    assert story.fly(4, good) is LEARNING
    assert story.fly(8, good) is TRUSTED
    assert [status for status, _ in itertools.groupby(story.statuses)] == [
        UNTRAINED, LEARNING, TRUSTED,
    ]  # fmt: skip


def test_an_estimate_that_knows_nothing_never_earns_trust():
    assert Story().fly(40, blind) is LEARNING


@pytest.mark.parametrize(("estimate", "within_s"), [(wrong, 20), (blind, 90)])
def test_trust_is_lost_in_another_room_and_earned_anew(estimate, within_s):
    story = Story()
    story.fly(12, good)
    before = story.frames
    assert story.fly(12, estimate) is STALE
    assert story.statuses.index(STALE) - before < within_s * RATE_HZ
    assert story.fly(4, good) is STALE
    assert story.fly(16, good) is TRUSTED


def test_without_stereo_novelty_takes_trust_and_nothing_gives_it_back():
    story = Story()
    story.fly(12, good)
    assert story.fly(5, good, truth=False) is TRUSTED
    before = story.frames
    assert story.fly(2, good, truth=False, novelty=2.5) is STALE
    assert story.statuses[before:].index(STALE) < 10 * RATE_HZ
    assert story.fly(20, good, truth=False) is STALE


def test_a_short_scare_changes_nothing():
    story = Story(confirm_s=10.0)
    story.fly(14, good)
    story.fly(1, lambda stereo_px, frame: 6.0 if frame % 80 < 10 else stereo_px)
    assert STALE not in story.statuses


def test_the_figures_are_those_of_the_window():
    story = Story(window_s=40.0)
    story.fly(10, good)
    figures = story.monitor.figures
    assert figures.frames == 400
    assert figures.approaches == 5
    assert figures.error_norm == pytest.approx(
        0.02 / np.var([*np.linspace(1, 5, 61)[:-1], *[2.0] * 20]), rel=0.1
    )
    assert figures.auc > 0.99


def test_the_window_holds_the_newest_frames_however_long_it_has_flown():
    rng, story, flown_px = np.random.default_rng(1), Story(window_s=10.0, recent_s=1.0), []

    def random(stereo_px, frame):
        flown_px.append((stereo_px, rng.uniform(1.0, 5.0)))
        return flown_px[-1][1]

    for _ in range(9):
        story.fly(1, random)
        figures = story.monitor.figures
        n_judged = figures.stamp_ns * RATE_HZ // 1_000_000_000 + 1
        stereo_px, mono_px = np.array(flown_px[:n_judged][-100:]).T
        assert figures.frames == len(stereo_px)
        assert figures.error_norm == pytest.approx(
            np.mean((mono_px - stereo_px) ** 2) / stereo_px.var()
        )


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(0, 20) | st.just(math.nan),
            st.floats(0, 20) | st.just(math.nan),
            st.floats(0, 9) | st.just(math.nan),
            st.sampled_from(BehaviourState),
            st.booleans(),
        ),
        max_size=80,
    )
)
def test_whatever_comes_trust_needs_truth(frames):
    monitor = TrustMonitor(
        TrustSettings(least_approaches=1, confirm_s=0.0, collision_probability=1.0, auc=0.0),
        APPROACH._replace(rate_hz=2.0),
        1.0,
        np.random.default_rng(0),
    )
    before = monitor.status
    for number, (stereo_px, mono_px, novelty, state, truth) in enumerate(frames):
        percept = Percept(
            stamp_ns=number * 500_000_000,
            stereo_px=stereo_px,
            stereo_valid_norm=1.0,
            mono_px=mono_px,
            mono_std_px=0.2,
            mono_novelty=novelty,
        )
        monitor.update(percept, state, 3.5, truth)
        assert truth or monitor.status is before or monitor.status is not TRUSTED
        before = monitor.status
