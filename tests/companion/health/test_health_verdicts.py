"""When a sign becomes a fault and a fault is over, when stereo may return, and what is robust."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from companion.health import CameraHealth, HealthSettings
from companion.health.agreement import Agreement
from companion.health.eyes import Eyes, Sign
from companion.health.timing import FrameClock
from companion.health.verdicts import Debounce
from companion.health.words import State, events_of
from companion.kernel.messages import Availability, CameraFault, Percept, StereoFrame

PERIOD_S = 0.1
SETTINGS = HealthSettings()
BLACK, TORN = Sign(CameraFault.BLACK, "dark"), Sign(CameraFault.TORN, "seam")
GREY = np.full((48, 64), 100, np.uint8)


def percept(stereo_px=2.0, mono_px=2.0):
    return Percept(
        stamp_ns=0, stereo_px=stereo_px, stereo_valid_norm=0.8, mono_px=mono_px, mono_std_px=0.5
    )


def fed(*signs):
    """The fault after each frame."""
    debounce = Debounce(SETTINGS)
    faults = []
    for sign in signs:
        debounce.update(sign, PERIOD_S)
        faults.append(debounce.fault)
    return faults


def test_a_sign_must_last_to_be_a_fault_and_stay_away_to_be_over():
    assert fed(BLACK) == [None]
    assert fed(BLACK, BLACK) == [None, CameraFault.BLACK]
    assert fed(BLACK, BLACK, *[None] * 14)[-1] is CameraFault.BLACK
    assert fed(BLACK, BLACK, *[None] * 15)[-1] is None
    assert fed(BLACK, BLACK, *[None] * 14, BLACK, *[None] * 14)[-1] is CameraFault.BLACK


def test_a_single_sign_now_and_then_is_none():
    assert set(fed(*[BLACK, *[None] * 9] * 20)) == {None}


def test_what_comes_and_goes_with_every_other_frame_is_a_fault():
    assert CameraFault.TORN in fed(*[TORN, None] * 5)


def test_the_fault_that_lasts_takes_the_place_of_the_first():
    assert fed(BLACK, BLACK, TORN, TORN)[-1] is CameraFault.TORN


@given(st.lists(st.sampled_from([None, BLACK, TORN]), max_size=80))
def test_whatever_is_seen_a_fault_was_seen_before_it_counts(signs):
    faults = fed(*signs)
    for number, fault in enumerate(faults):
        if fault is not None:
            assert sum(sign is not None and sign.fault is fault for sign in signs[: number + 1]) > 1
    assert all(fault is None for fault in fed(*signs, *[None] * 16)[-1:])


def test_stereo_returns_when_it_agrees_as_usual():
    agreement = Agreement(agree_s=1.0)
    for _ in range(1000):
        agreement.learn(percept(mono_px=2.4), PERIOD_S)
    answers = [agreement.reached(percept(mono_px=2.5), PERIOD_S) for _ in range(11)]
    assert sum(answers) == 1
    assert agreement.difference_px == pytest.approx(0.5)
    assert not any(agreement.reached(percept(mono_px=4.0), PERIOD_S) for _ in range(50))


def test_what_is_unknown_agrees_with_nothing():
    agreement = Agreement(agree_s=1.0)
    unknown = percept(stereo_px=math.nan)
    assert not any(agreement.reached(unknown, PERIOD_S) for _ in range(50))


@pytest.mark.parametrize("late_s", [0.1, 0.3])
def test_a_frame_is_late_against_the_promptest_on_any_clock(late_s):
    clock = FrameClock()
    for number in range(50):
        assert clock.tick(StereoFrame(number * 10**8, GREY, GREY), 7000.0 + number * 0.1) is None
    sign = clock.tick(StereoFrame(50 * 10**8, GREY, GREY), 7005.0 + late_s)
    assert clock.late_s == pytest.approx(late_s, abs=0.01)
    assert (sign is not None) == (late_s > 0.2)


@pytest.mark.parametrize(
    "arrivals_s",
    [
        lambda stamp_s: (2 * stamp_s, stamp_s),  # a simulator that runs at half its speed
        lambda stamp_s: (stamp_s, stamp_s - (stamp_s < 2.0)),  # a link that lagged by a second
        lambda stamp_s: (stamp_s, math.nan),
    ],
)
def test_a_frame_is_late_only_where_all_clocks_say_so(arrivals_s):
    clock = FrameClock()
    for number in range(50):
        frame = StereoFrame(number * 10**8, GREY, GREY)
        assert clock.tick(frame, *arrivals_s(number * 0.1)) is None
    assert clock.late_s == pytest.approx(0.0, abs=0.01)


def test_clocks_may_drift_apart():
    """100 parts in a million for an hour are a third of a second."""
    clock = FrameClock()
    signs = {
        clock.tick(StereoFrame(number * 10**9, GREY, GREY), number * 1.0001)
        for number in range(3600)
    }
    assert signs == {None}


def test_a_stamp_that_is_not_later_is_out_of_step():
    clock = FrameClock()
    clock.tick(StereoFrame(10**9, GREY, GREY), math.nan)
    for stamp_ns in (10**9, 5 * 10**8):
        sign = clock.tick(StereoFrame(stamp_ns, GREY, GREY), math.nan)
        assert sign is not None
        assert sign.fault is CameraFault.DESYNCHRONISED


def test_old_frames_are_not_flown_on_but_stereo_is_back_with_the_next():
    health = CameraHealth(SETTINGS, stale_after_s=0.5)
    rng = np.random.default_rng(0)
    outlooks = []
    for number, late_s in enumerate((0.0, 0.0, 0.9, 0.0)):
        left, right = rng.integers(60, 200, (2, 48, 64), np.uint8)
        frame = StereoFrame((number + 1) * 10**8, left, right)
        health.look(frame, number * 0.1 + late_s)
        outlooks.append(health.conclude(percept(), trusted=True).available)
    everything, nothing = Availability(), Availability(stereo=False, left=False, right=False)
    assert outlooks == [everything, everything, nothing, everything]


SHAPES = st.sampled_from([(0, 0), (1, 1), (8, 8), (24, 32)])
IMAGES = SHAPES.flatmap(lambda shape: arrays.arrays(np.uint8, shape, fill=st.integers(0, 255)))


@settings(max_examples=60)
@given(st.lists(IMAGES, min_size=2, max_size=4))
def test_whatever_images_come_looking_does_not_fail(images):
    eyes = Eyes()
    for left, right in itertools.pairwise(images):
        if left.shape == right.shape or not left.size or not right.size:
            signs = eyes.look(left, right, PERIOD_S)
            for image, sign in zip((left, right), signs, strict=True):
                assert image.size or sign.fault is CameraFault.NO_FRAMES


@pytest.mark.parametrize(
    ("state", "available", "trusted", "said"),
    [
        (State(right=CameraFault.BLACK), (False, True, False), True, "flying on the left eye"),
        (State(right=CameraFault.BLACK), (False, True, False), False, "stopping"),
        (State(pair=CameraFault.SWAPPED), (False, True, True), True, "flying on one eye"),
        (State(timing=CameraFault.LATE), (True, True, True), False, "flying on"),
        (State(left=CameraFault.HALF), (False, False, False), True, "stopping"),
    ],
)
def test_a_statustext_has_room_for_what_matters(state, available, trusted, said):
    evidence = dict.fromkeys(State._fields, "figures")
    (event,) = events_of(5, state, State(), evidence, Availability(*available), trusted)
    assert f"; {said} (figures)" in event.text
    assert len(event.text.partition(" (")[0]) <= 49
