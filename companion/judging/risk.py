"""What an estimate's mistakes cost in flight: collisions and spurious turns (section III-E).

Vocabulary of the paper: a sample is positive where stereo's λ exceeds the positive threshold; mono
is silent where its λ does not exceed its own. An approach that ends at an obstacle passes negative
samples first and then ``n_positives`` positive ones; it ends in a collision where mono stays silent
on all of them. Figures that nothing was seen for are NaN.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Counts = NDArray[np.float64]

TN, FP, FN, TP = range(4)
"""Kinds of sample, the states of the Markov chain: detected + 2 * positive."""

RESAMPLES = 400
INTERVAL_NORM = 0.9
"""Share of the resampled figures that an interval holds; 5 % lie above it."""
CANDIDATES_NORM = np.linspace(0.5, 1.25, 61)
"""Thresholds that are tried, as a share of the positive threshold."""


def collision_probability_iid(
    tpr: float, n_positives: int, fpr: float = 0.0, n_negatives: int = 0
) -> float:
    """Of one approach with independent samples: silent on all of them (the paper's eq. 2)."""
    return float((1.0 - fpr) ** n_negatives * (1.0 - tpr) ** n_positives)


def silence_probability(identical: float, tpr: float) -> float:
    """Ω of silence after silence on positives, where a sample is classified like the one before
    it with probability ``identical`` and else independently (the paper's example of dependence).
    """
    return identical + (1.0 - identical) * (1.0 - tpr)


def collision_probability_dependent(silence: float, n_positives: int) -> float:
    """Of an approach that has been silent so far: each positive sample follows a silent one.

    The paper's formula has the exponent s - 1, but its figure (0.81 and s = 30 give 1.8e-3) has s,
    and so do we: the first positive follows a silent negative.
    """
    return silence**n_positives


def spurious_turns_per_s(fpr: float, rate_hz: float) -> float:
    """While all samples are negative; ``fpr`` may be the chain's P(FP | TN before)."""
    return fpr * rate_hz


def spurious_turns_per_m(fpr: float, rate_hz: float, speed_m_s: float) -> float:
    return spurious_turns_per_s(fpr, rate_hz) / speed_m_s


class Approach(NamedTuple):
    """The straight flight towards an obstacle, at constant velocity."""

    rate_hz: float
    speed_m_s: float
    disparity_metre_px: float
    """λ of an obstacle at 1 m: focal length times baseline."""
    positive_threshold_px: float

    @property
    def samples_per_m(self) -> float:
        return self.rate_hz / self.speed_m_s

    def positives_until(self, distance_m: float) -> int:
        """Samples from the first positive one until the obstacle is this near; at least one.

        One as well where nothing moves, and so nothing comes nearer.
        """
        if self.speed_m_s <= 0.0:
            return 1
        first_m = self.disparity_metre_px / self.positive_threshold_px
        return max(1, math.floor((first_m - distance_m) / self.speed_m_s * self.rate_hz))


class Samples(NamedTuple):
    """Frames of straight flight in order, all (n_samples,); both cues know λ on each."""

    stereo_px: Floats
    mono_px: Floats
    approach: NDArray[np.int64]
    """Number of the approach that a sample belongs to."""


class Tally(NamedTuple):
    """How often each kind of sample occurred and followed which within an approach.

    kinds: (..., 4); transitions: (..., 4, 4), from and to. Leading axes: resamples, thresholds.
    """

    kinds: Counts
    transitions: Counts

    @property
    def tpr(self) -> Floats:
        return _ratio(self.kinds[..., TP], self.kinds[..., TP] + self.kinds[..., FN])

    @property
    def fpr(self) -> Floats:
        return _ratio(self.kinds[..., FP], self.kinds[..., FP] + self.kinds[..., TN])

    @property
    def omega(self) -> Floats:
        """The transition matrix; a row is NaN where its state was never left."""
        return _ratio(self.transitions, self.transitions.sum(axis=-1, keepdims=True))

    @property
    def silence(self) -> Floats:
        """Ω of silence on a positive sample after a silent one."""
        after_silence = self.transitions[..., TN, :] + self.transitions[..., FN, :]
        return _never_certain(after_silence[..., FN], after_silence[..., TP])

    @property
    def reach(self) -> Floats:
        """Probability that silent negatives end in a positive sample, not in a spurious turn."""
        after_negative = self.transitions[..., TN, :]
        positive = after_negative[..., FN] + after_negative[..., TP]
        return _never_certain(positive, after_negative[..., FP])

    @property
    def spurious(self) -> Floats:
        """P(FP | TN before, negative now): what a silent negative sample risks."""
        after_negative = self.transitions[..., TN, :]
        return _ratio(after_negative[..., FP], after_negative[..., FP] + after_negative[..., TN])

    def collision_probability(self, n_positives: int) -> Floats:
        """Of one approach: the chance that the chain is absorbed by the collision.

        NaN where no positive sample was seen.
        """
        seen = self.kinds[..., TP] + self.kinds[..., FN] > 0
        return np.where(seen, self.reach * self.silence**n_positives, np.nan)


def tally(samples: Samples, positive_threshold_px: float, thresholds_px: ArrayLike) -> Tally:
    """Counts per approach and threshold: leading axes (n_approaches, n_thresholds)."""
    thresholds = np.atleast_1d(np.asarray(thresholds_px, dtype=np.float64))
    names, approach = np.unique(samples.approach, return_inverse=True)
    positive = samples.stereo_px > positive_threshold_px
    detected = samples.mono_px[:, None] > thresholds
    kind = detected + 2 * positive[:, None]
    columns = np.broadcast_to(np.arange(len(thresholds)), kind.shape)
    kinds = np.zeros((len(names), len(thresholds), 4))
    np.add.at(kinds, (approach[:, None], columns, kind), 1.0)
    transitions = np.zeros((len(names), len(thresholds), 4, 4))
    same = np.flatnonzero(np.diff(approach) == 0)
    steps = (approach[same, None], columns[same], kind[same], kind[same + 1])
    np.add.at(transitions, steps, 1.0)
    return Tally(kinds, transitions)


def total(per_approach: Tally) -> Tally:
    """All approaches together."""
    return Tally(per_approach.kinds.sum(axis=0), per_approach.transitions.sum(axis=0))


def resample(per_approach: Tally, rng: np.random.Generator, n_resamples: int = RESAMPLES) -> Tally:
    """Block bootstrap: flights made of as many approaches, drawn with replacement.

    Samples within an approach depend on each other, so whole approaches are drawn. The leading
    axis becomes (n_resamples,).
    """
    n_approaches = len(per_approach.kinds)
    if not n_approaches:
        return Tally(*(np.zeros((n_resamples, *part.shape[1:])) for part in per_approach))
    shares = np.full(n_approaches, 1.0 / n_approaches)
    times = rng.multinomial(n_approaches, shares, size=n_resamples).astype(np.float64)
    return Tally(*(np.tensordot(times, part, axes=1) for part in per_approach))


def interval(resampled: Floats) -> tuple[Floats, Floats]:
    """(low, high) around INTERVAL_NORM of the resampled values; NaN where none is known."""
    tail = (1.0 - INTERVAL_NORM) / 2.0
    known = ~np.isnan(resampled).all(axis=0)
    filled = np.where(known, resampled, 0.0)
    low, high = (np.nanquantile(filled, q, axis=0) for q in (tail, 1.0 - tail))
    return np.where(known, low, np.nan), np.where(known, high, np.nan)


class Wishes(NamedTuple):
    """What a threshold shall reach."""

    collision_probability: float
    """Of one approach."""
    spurious_turns_per_m: float
    detection_distance_m: float
    """An obstacle detected later than this is a collision."""


def choose_threshold_px(
    samples: Samples, approach: Approach, wishes: Wishes, rng: np.random.Generator
) -> float:
    """Mono's threshold from what the flight has shown; NaN while no positive was seen.

    A threshold is safe where the upper end of the interval of its collision probability keeps the
    wish. Of the safe ones it is the lowest that turns rarely enough. Where the wishes contradict
    each other, safety comes first: it is the highest safe one, however often that turns; where
    none is safe, the safest.
    """
    candidates_px = CANDIDATES_NORM * approach.positive_threshold_px
    per_approach = tally(samples, approach.positive_threshold_px, candidates_px)
    n_positives = approach.positives_until(wishes.detection_distance_m)
    _, collision = interval(resample(per_approach, rng).collision_probability(n_positives))
    if np.isnan(collision).any():
        return math.nan
    # With a higher threshold it collides no less and turns no more; few samples may hide that.
    collision = np.maximum.accumulate(collision)
    spurious = np.nan_to_num(total(per_approach).spurious, nan=0.0)
    turns_per_m = np.maximum.accumulate(spurious[::-1])[::-1] * approach.samples_per_m
    safe = collision <= max(wishes.collision_probability, float(collision[0]))
    good = safe & (turns_per_m <= wishes.spurious_turns_per_m)
    return float(candidates_px[good][0] if good.any() else candidates_px[safe][-1])


def _ratio(part: Floats, whole: Floats) -> Floats:
    part, whole = np.broadcast_arrays(part, whole)
    unknown = np.full(part.shape, np.nan)
    return np.asarray(np.divide(part, whole, out=unknown, where=whole > 0), np.float64)


def _never_certain(happened: Counts, other: Counts) -> Floats:
    """A probability from counts, half an event added to each side (Jeffreys' prior).

    Positives are rare, as the paper says: one that was detected must not mean that all will be.
    """
    return (happened + 0.5) / (happened + other + 1.0)
