"""The performance model: the paper's worked examples, identities, planted chains found again."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.flying.switch import Choice
from companion.judging import risk
from companion.judging.scorecard import Scorecard
from companion.kernel.messages import BehaviourState, Cue, Percept, Phase

POSITIVE_PX = 4.0
PAPERS = risk.Approach(
    rate_hz=30.0, speed_m_s=0.5, disparity_metre_px=6.0, positive_threshold_px=4.0
)
"""Positives are nearer than 1.5 m."""
probabilities = st.floats(0.01, 0.99)


def test_the_papers_approach_has_30_positive_samples():
    assert PAPERS.positives_until(1.0) == 30
    assert PAPERS.positives_until(5.0) == 1  # detected before it is positive: one is needed


@pytest.mark.parametrize(("tpr", "collision"), [(0.95, 9.31e-40), (0.30, 2.25e-5)])
def test_the_papers_independent_samples(tpr, collision):
    assert risk.collision_probability_iid(tpr, 30) == pytest.approx(collision, rel=2e-3)


def test_the_papers_dependent_samples():
    silence = risk.silence_probability(identical=0.8, tpr=0.95)
    assert silence == pytest.approx(0.81)
    assert risk.collision_probability_dependent(silence, 30) == pytest.approx(1.8e-3, rel=2e-3)


def test_the_papers_spurious_turns():
    assert risk.spurious_turns_per_s(0.05, 30.0) == pytest.approx(1.5)
    assert risk.spurious_turns_per_m(0.05, 30.0, 0.5) == pytest.approx(3.0)
    assert risk.spurious_turns_per_m(0.0017, 30.0, 0.5) == pytest.approx(0.1, rel=0.03)


@given(probabilities, probabilities, st.integers(0, 20), st.integers(1, 20))
def test_false_positives_on_the_way_prevent_collisions(tpr, fpr, n_negatives, n_positives):
    whole = risk.collision_probability_iid(tpr, n_positives, fpr, n_negatives)
    tail = risk.collision_probability_iid(tpr, n_positives)
    assert whole == pytest.approx(tail * (1 - fpr) ** n_negatives)


@given(probabilities, st.integers(1, 40))
def test_without_dependence_the_chain_is_the_product_formula(tpr, n_positives):
    silence = risk.silence_probability(0.0, tpr)
    dependent = risk.collision_probability_dependent(silence, n_positives)
    assert dependent == pytest.approx(risk.collision_probability_iid(tpr, n_positives))


@given(probabilities, probabilities, probabilities, st.integers(1, 12))
def test_absorption_equals_that_of_the_whole_transition_matrix(to_positive, fp, silence, n):
    """States: silent negative, n positives survived in silence, avoided; the last one collides."""
    negative = np.array([(1 - to_positive) * (1 - fp), to_positive, (1 - to_positive) * fp])
    omega = np.zeros((n + 2, n + 2))
    omega[0, 0], omega[0, -1] = negative[0], negative[2] + to_positive * (1 - silence)
    omega[0, 1] = to_positive * silence
    for survived in range(1, n):
        omega[survived, survived + 1], omega[survived, -1] = silence, 1 - silence
    omega[n, n] = omega[-1, -1] = 1.0
    absorbed = np.linalg.matrix_power(omega, 4096)[0, n]
    scale = 1e9  # counts so large that half an event on each side does not matter
    transitions = np.zeros((4, 4))
    transitions[risk.TN] = scale * np.array(
        [negative[0], negative[2], to_positive * silence, to_positive * (1 - silence)]
    )
    transitions[risk.FN, [risk.FN, risk.TP]] = scale * np.array([silence, 1 - silence])
    tally = risk.Tally(kinds=np.ones(4), transitions=transitions)
    assert tally.collision_probability(n) == pytest.approx(absorbed, rel=1e-5)


def planted(rng, n_approaches=4000, to_positive=0.05, fp=0.02, silence=0.7, n_positives=20):
    """Approaches that end in a detection or a collision, as the chain says."""
    stereo, mono, approach = [], [], []
    for number in range(n_approaches):
        positives = 0
        detected = False
        stereo.append(3.0), mono.append(3.0), approach.append(number)
        while not detected and positives < n_positives:
            positives += positives > 0 or rng.random() < to_positive
            detected = bool(rng.random() < (1 - silence if positives else fp))
            stereo.append(5.0 if positives else 3.0), mono.append(5.0 if detected else 3.0)
            approach.append(number)
    return risk.Samples(np.array(stereo), np.array(mono), np.array(approach))


TRUTHS = {"silence": 0.7, "spurious": 0.02, "reach": 0.05 / (0.05 + 0.95 * 0.02)}


def test_a_planted_chain_is_found_again():
    found = risk.total(risk.tally(planted(np.random.default_rng(1)), POSITIVE_PX, 4.0))
    for name, truth in TRUTHS.items():
        assert getattr(found, name)[0] == pytest.approx(truth, rel=0.1), name
    expected = TRUTHS["reach"] * 0.7**10
    assert found.collision_probability(10)[0] == pytest.approx(expected, rel=0.3)
    assert found.omega[0, risk.TN].sum() == pytest.approx(1.0)
    assert np.isnan(found.omega[0, risk.TP]).all()  # a detection ended each approach


def test_intervals_hold_the_truth_as_often_as_they_say():
    held = dict.fromkeys(TRUTHS, 0)
    for seed in range(60):
        flight = planted(np.random.default_rng(seed), n_approaches=100)
        per_approach = risk.tally(flight, POSITIVE_PX, 4.0)
        resampled = risk.resample(per_approach, np.random.default_rng(seed))
        for name, truth in TRUTHS.items():
            low, high = risk.interval(getattr(resampled, name))
            held[name] += int(low[0] <= truth <= high[0])
    assert all(0.8 <= count / 60 <= 0.98 for count in held.values()), held


def test_predicted_collisions_are_as_frequent_as_planted_ones():
    samples = planted(np.random.default_rng(3), silence=0.9)
    n_approaches = len(np.unique(samples.approach))
    last = np.append(np.flatnonzero(np.diff(samples.approach)), len(samples.approach) - 1)
    observed = np.count_nonzero(samples.mono_px[last] < POSITIVE_PX) / n_approaches
    resampled = risk.resample(risk.tally(samples, POSITIVE_PX, 4.0), np.random.default_rng(4))
    low, high = risk.interval(resampled.collision_probability(20))
    assert low[0] < observed < high[0]


def test_rates_are_those_of_the_samples():
    samples = planted(np.random.default_rng(5), n_approaches=300)
    positive, detected = samples.stereo_px > POSITIVE_PX, samples.mono_px > 4.0
    found = risk.total(risk.tally(samples, POSITIVE_PX, 4.0))
    assert found.tpr[0] == pytest.approx(detected[positive].mean())
    assert found.fpr[0] == pytest.approx(detected[~positive].mean())


def test_transitions_do_not_cross_from_one_approach_to_the_next():
    samples = risk.Samples(np.full(4, 3.0), np.full(4, 3.0), np.array([1, 1, 2, 2]))
    assert risk.total(risk.tally(samples, POSITIVE_PX, 4.0)).transitions.sum() == 2


def test_the_same_seed_gives_the_same_interval():
    per_approach = risk.tally(planted(np.random.default_rng(6), 50), POSITIVE_PX, 4.0)
    one, other = (risk.resample(per_approach, np.random.default_rng(7)) for _ in range(2))
    assert np.array_equal(one.transitions, other.transitions)


def wishes(collision=1e-3, turns=0.1):
    return risk.Wishes(collision, turns, detection_distance_m=1.0)


def estimates(rng, noise_px, n_approaches=300):
    """λ grows along each approach; mono sees it with noise."""
    stereo = np.tile(np.linspace(1.0, 6.0, 40), n_approaches)
    approach = np.repeat(np.arange(n_approaches), 40)
    return risk.Samples(stereo, stereo + rng.normal(0.0, noise_px, len(stereo)), approach)


def choose(samples, wanted):
    return risk.choose_threshold_px(samples, PAPERS, wanted, np.random.default_rng(1))


def test_a_threshold_that_keeps_both_wishes_is_found():
    samples = estimates(np.random.default_rng(8), noise_px=0.1)
    threshold_px = choose(samples, wishes(1e-3, 1.0))
    found = risk.total(risk.tally(samples, POSITIVE_PX, threshold_px))
    assert found.collision_probability(30)[0] <= 1e-3
    assert found.spurious[0] * PAPERS.samples_per_m <= 1.0


def test_where_the_wishes_contradict_each_other_safety_comes_first():
    samples = estimates(np.random.default_rng(9), noise_px=1.5)
    thresholds_px = [choose(samples, wishes(collision, 1e-6)) for collision in (1e-2, 1e-12)]
    assert thresholds_px[1] < thresholds_px[0]
    for threshold_px, wanted in zip(thresholds_px, (1e-2, 1e-12), strict=True):
        found = risk.total(risk.tally(samples, POSITIVE_PX, threshold_px))
        assert found.collision_probability(30)[0] <= wanted


@pytest.mark.parametrize("n", [0, 50])
def test_without_positives_there_is_no_threshold(n):
    samples = risk.Samples(np.full(n, 3.0), np.full(n, 2.0), np.zeros(n, np.int64))
    assert math.isnan(choose(samples, wishes()))


def test_the_scorecard_knows_approaches_and_what_ended_them():
    """Two approaches, the second cut by a phase; turning frames belong to none."""
    straight, rotate = BehaviourState.STRAIGHT, BehaviourState.ROTATE
    story = [
        (Phase.INITIAL, rotate, 9.0),
        *[(Phase.INITIAL, straight, 1.0)] * 2,
        (Phase.INITIAL, rotate, 5.0),
        (Phase.INITIAL, rotate, 9.0),
        (Phase.INITIAL, straight, 2.0),
        (Phase.LEARNING, straight, 3.0),
        (Phase.LEARNING, rotate, 5.5),
    ]
    card = Scorecard(POSITIVE_PX)
    for frame, (phase, state, stereo_px) in enumerate(story):
        percept = Percept(
            stamp_ns=frame * 100_000_000,
            stereo_px=stereo_px,
            stereo_valid_norm=1.0,
            mono_px=stereo_px,
            mono_std_px=0.0,
        )
        card.record(percept, phase, Choice(Cue.STEREO, False, 1.0, 4.0, False), state, 4.0)
    samples = card.approach_samples((Phase.INITIAL, Phase.LEARNING))
    assert samples.stereo_px.tolist() == [1.0, 1.0, 5.0, 2.0, 3.0, 5.5]
    assert samples.approach.tolist() == [1, 1, 1, 2, 3, 3]


def test_a_vehicle_that_hovers_approaches_nothing():
    hovering = risk.Approach(
        rate_hz=10.0, speed_m_s=0.0, disparity_metre_px=7.0, positive_threshold_px=4.0
    )
    assert hovering.positives_until(1.0) == 1
