"""The performance model (paper section III-E) fitted to a flight, beside what was observed."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from companion.flightlog import FlightLog
from companion.judging.risk import (
    INTERVAL_NORM,
    Approach,
    Floats,
    Samples,
    Tally,
    collision_probability_iid,
    interval,
    resample,
    spurious_turns_per_m,
    spurious_turns_per_s,
    tally,
    total,
)
from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import RecordingError
from companion.kernel.messages import Phase
from companion.thresholds import PHASES_OF_LEARNING, approach_of
from tools.flown import FlownFlight


class Figure(msgspec.Struct, frozen=True):
    """A predicted figure and its bootstrap interval; NaN (null in JSON) where nothing tells."""

    value: float
    low: float
    high: float


class Prediction(msgspec.Struct, frozen=True, kw_only=True):
    """The model fitted to some phases."""

    approaches: int
    samples: int
    positives: int
    tpr: Figure
    fpr: Figure
    silence: Figure
    """Ω: mono stays silent on a positive sample after a silent one."""
    collision_iid: Figure
    """Of one approach with independent samples; below with the flight's own dependence."""
    collision: Figure
    override: Figure
    """As ``collision``, but until stereo would override."""
    spurious_turns_per_s_iid: Figure
    spurious_turns_per_s: Figure
    spurious_turns_per_m: Figure


class Observed(msgspec.Struct, frozen=True, kw_only=True):
    """The same figures counted in the test phase, by approach that mono flew."""

    mono_approaches: int
    override: float
    collision: float | None
    """Contacts per approach, overrides or not; None without motion capture."""
    spurious_turns_per_s: float
    """Per time of straight flight with mono on clear way."""
    spurious_turns_per_m: float


class Report(msgspec.Struct, frozen=True, kw_only=True):
    flight: str
    threshold_px: float
    positive_threshold_px: float
    positives_to_collision: int
    positives_to_override: int
    interval_norm: float
    from_learning: Prediction
    from_test: Prediction
    observed: Observed


def assess(flight: FlownFlight, seed: int = 1) -> Report:
    """Predicted and observed figures; ``seed`` is the bootstrap's. Raises RecordingError."""
    plan = flight.plan
    approach = approach_of(plan, _calibration(flight.log))
    near_px = plan.behaviour.override_threshold_px
    n_collision = approach.positives_until(plan.learner.detection_distance_m)
    n_override = approach.positives_until(approach.disparity_metre_px / near_px)
    threshold_px = flight.mono_threshold_px(Phase.TEST)
    rng = np.random.default_rng(seed)

    def predict(phases: Sequence[Phase]) -> Prediction:
        samples = flight.scorecard.approach_samples(phases)
        return _predict(samples, approach, threshold_px, (n_collision, n_override), rng)

    return Report(
        flight=flight.name,
        threshold_px=threshold_px,
        positive_threshold_px=approach.positive_threshold_px,
        positives_to_collision=n_collision,
        positives_to_override=n_override,
        interval_norm=INTERVAL_NORM,
        from_learning=predict(PHASES_OF_LEARNING),
        from_test=predict([Phase.TEST]),
        observed=_observe(flight, approach),
    )


def _calibration(log: FlightLog) -> StereoCalibration:
    if log.metadata.calibration is None:
        raise RecordingError(f"{log.path}: says nothing about its camera's calibration")
    return log.metadata.calibration


def _predict(
    samples: Samples,
    approach: Approach,
    threshold_px: float,
    n_positives: tuple[int, int],
    rng: np.random.Generator,
) -> Prediction:
    per_approach = tally(samples, approach.positive_threshold_px, threshold_px)
    found, resampled = (_first(part) for part in (total(per_approach), resample(per_approach, rng)))

    def figure(name: str) -> Figure:
        return _figure(getattr(found, name), getattr(resampled, name))

    tpr, spurious = figure("tpr"), figure("spurious")
    fpr = figure("fpr")
    n_collision, n_override = n_positives
    return Prediction(
        approaches=len(per_approach.kinds),
        samples=len(samples.stereo_px),
        positives=int(np.count_nonzero(samples.stereo_px > approach.positive_threshold_px)),
        tpr=tpr,
        fpr=fpr,
        silence=figure("silence"),
        collision_iid=Figure(
            *(collision_probability_iid(r, n_collision) for r in (tpr.value, tpr.high, tpr.low))
        ),
        collision=_absorbed(found, resampled, n_collision),
        override=_absorbed(found, resampled, n_override),
        spurious_turns_per_s_iid=_scaled(fpr, spurious_turns_per_s(1.0, approach.rate_hz)),
        spurious_turns_per_s=_scaled(spurious, spurious_turns_per_s(1.0, approach.rate_hz)),
        spurious_turns_per_m=_scaled(
            spurious, spurious_turns_per_m(1.0, approach.rate_hz, approach.speed_m_s)
        ),
    )


def _first(counts: Tally) -> Tally:
    """Of the one threshold."""
    return Tally(counts.kinds[..., 0, :], counts.transitions[..., 0, :, :])


def _figure(value: Floats, resampled: Floats) -> Figure:
    low, high = interval(resampled)
    return Figure(float(value), float(low), float(high))


def _absorbed(found: Tally, resampled: Tally, n_positives: int) -> Figure:
    values = (counts.collision_probability(n_positives) for counts in (found, resampled))
    return _figure(*values)


def _scaled(figure: Figure, factor: float) -> Figure:
    return Figure(figure.value * factor, figure.low * factor, figure.high * factor)


def _observe(flight: FlownFlight, approach: Approach) -> Observed:
    test = flight.in_phase(Phase.TEST)
    decision, stereo_px = flight.decision, flight.percept["stereo_px"]
    account = flight.scorecard.accounts[Phase.TEST]
    straight = decision["state"] == "straight"
    clear = test & (decision["cue"] == "mono") & (stereo_px <= approach.positive_threshold_px)
    ended = np.append(False, straight[:-1]) & ~straight & np.append(False, test[:-1])
    frames = np.count_nonzero(clear & (straight | ended))
    turns_per_s = _share(int(np.count_nonzero(clear & ended)), frames / approach.rate_hz)
    collisions: float | None = None
    if flight.has_truth and test.any():
        contacts = flight.truth["truth_collisions"][test]
        collisions = _share(int(contacts[-1] - contacts[0]), account.mono_approaches)
    return Observed(
        mono_approaches=account.mono_approaches,
        override=_share(account.overrides, account.mono_approaches),
        collision=collisions,
        spurious_turns_per_s=turns_per_s,
        spurious_turns_per_m=turns_per_s / approach.speed_m_s,
    )


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole else math.nan
