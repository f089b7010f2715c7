"""How far the learned estimate may be relied on: its public status, from recent flight.

While stereo is there it is the judge: error, ROC and predicted collision risk over a window of
frames that were estimated before they were learned from, and the error of the last seconds. Without
it only novelty tells that what is seen is not what was learned.
"""

import math
from collections import deque
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from companion.judging.performance import roc_curve
from companion.judging.risk import Approach, Samples, interval, resample, tally
from companion.kernel.messages import (
    BehaviourState,
    Event,
    Percept,
    TrustFigures,
    TrustStatus,
)
from companion.kernel.settings import Settings

Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, le=1)]

JUDGED_EVERY_NS = 1_000_000_000
RESAMPLES = 200
TURNING = 0
"""Number of the approach of a frame that belongs to none."""


class TrustSettings(Settings, frozen=True):
    """``[trust]``: what recent flight must have shown."""

    window_s: Annotated[float, Meta(ge=1, le=3600)] = 120.0
    """Of frames on which both cues knew λ."""
    least_approaches: Annotated[int, Meta(ge=1)] = 8
    """In the window, that came to an obstacle."""
    error_norm: Positive = 0.5
    """Mean square error over the variance of stereo's λ: at most."""
    auc: Share = 0.9
    """Area under the ROC curve: at least."""
    collision_probability: Share = 0.2
    """Of an approach, as judging/risk.py predicts it with 95 % confidence: at most. While stereo
    flies it turns at once, so that all that is seen is whether mono was silent until then."""
    slack: Annotated[float, Meta(ge=1)] = 2.0
    """Trust once given lasts until a limit is missed by this factor."""
    recent_s: Positive = 10.0
    """The last seconds, which tell of sudden changes."""
    recent_error_norm: Positive = 0.7
    """Mean square error of the last seconds over the variance in the window: at most."""
    novelty: Positive = 1.5
    """Mean novelty of the last seconds: at most. Only asked where stereo cannot tell."""
    confirm_s: Annotated[float, Meta(ge=0)] = 3.0
    """A change of status must have been due for this long."""


class TrustHistory:
    """When the status changed, of a flight or of its log."""

    def __init__(self) -> None:
        self.status = TrustStatus.UNTRAINED
        self.trusted_after_s = math.nan
        """From the first frame to the first that was trusted."""
        self.times_lost = 0
        self._began_ns: int | None = None

    def note(self, stamp_ns: int, status: TrustStatus) -> None:
        """The status on a frame."""
        if self._began_ns is None:
            self._began_ns = stamp_ns
        if status is TrustStatus.TRUSTED and math.isnan(self.trusted_after_s):
            self.trusted_after_s = (stamp_ns - self._began_ns) * 1e-9
        self.times_lost += status is TrustStatus.STALE and self.status is not status
        self.status = status


class TrustMonitor:
    """Follows the flight frame by frame, and judges once a second.

    Trust is given by the truth alone, and taken by the truth or, where there is none, by novelty.
    An estimate that lost it must earn it anew: the window is emptied.
    """

    def __init__(
        self,
        settings: TrustSettings,
        approach: Approach,
        detection_distance_m: float,
        rng: np.random.Generator,
    ) -> None:
        self.settings = settings
        self.figures = TrustFigures(stamp_ns=0, status=TrustStatus.UNTRAINED)
        self._positive_px = approach.positive_threshold_px
        self._n_positives = approach.positives_until(detection_distance_m)
        self._rng = rng
        n_recent = max(1, round(settings.recent_s * approach.rate_hz))
        n_window = max(n_recent, round(settings.window_s * approach.rate_hz))
        self._window = _Window(n_window)
        self._squared_px2: deque[float] = deque(maxlen=n_recent)
        self._novelty: deque[float] = deque(maxlen=n_recent)
        self._n_approaches = 0
        self._state: BehaviourState | None = None
        self._judged_ns: int | None = None
        self._settled_ns = 0
        """When the status was last what it should be."""

    @property
    def status(self) -> TrustStatus:
        return self.figures.status

    def update(
        self,
        percept: Percept,
        state: BehaviourState,
        mono_threshold_px: float,
        has_truth: bool,
        caution_px: float = 0.0,
    ) -> bool:
        """One frame on; True where it was time to judge. ``has_truth``: stereo is healthy.

        ``caution_px`` is added to mono's λ before it is compared with its threshold.
        """
        self._take_in(percept, state, caution_px)
        stamp_ns = percept.stamp_ns
        if self._judged_ns is None:
            self._judged_ns = self._settled_ns = stamp_ns
        if stamp_ns - self._judged_ns < JUDGED_EVERY_NS:
            return False
        self._judged_ns = stamp_ns
        figures = self._judge(stamp_ns, mono_threshold_px)
        status = self._confirmed(due_status(figures, self.settings, has_truth), stamp_ns)
        self.figures = msgspec.structs.replace(figures, status=status)
        return True

    def _take_in(self, percept: Percept, state: BehaviourState, caution_px: float) -> None:
        straight = BehaviourState.STRAIGHT
        before, self._state = self._state, state
        self._n_approaches += state is straight and before is not straight
        if not math.isnan(percept.mono_novelty):
            self._novelty.append(percept.mono_novelty)
        if math.isnan(percept.stereo_px) or math.isnan(percept.mono_px):
            return
        # The frame that ends an approach belongs to it: on it the obstacle was detected.
        number = self._n_approaches if straight in (state, before) else TURNING
        cautious_px = percept.mono_px + caution_px
        self._window.append((percept.stereo_px, percept.mono_px, cautious_px, number))
        self._squared_px2.append((percept.mono_px - percept.stereo_px) ** 2)

    def _confirmed(self, due: TrustStatus, stamp_ns: int) -> TrustStatus:
        """The status that is due, once it has been for long enough."""
        if due is self.status:
            self._settled_ns = stamp_ns
        elif stamp_ns - self._settled_ns >= self.settings.confirm_s * 1e9:
            self._settled_ns = stamp_ns
            if due is TrustStatus.STALE:
                self._window.clear()
                self._squared_px2.clear()
            return due
        return self.status

    def _judge(self, stamp_ns: int, mono_threshold_px: float) -> TrustFigures:
        """The figures of the window; NaN where nothing defines one."""
        stereo_px, mono_px, cautious_px, approach = self._window.columns()
        known = len(stereo_px) > 0
        variance_px2 = float(stereo_px.var()) if known else math.nan
        error_px2 = float(np.mean((mono_px - stereo_px) ** 2)) if known else math.nan
        flown = approach != TURNING
        samples = Samples(stereo_px[flown], cautious_px[flown], approach[flown])
        ended = np.unique(samples.approach[samples.stereo_px > self._positive_px])
        return TrustFigures(
            stamp_ns=stamp_ns,
            status=self.status,
            frames=len(stereo_px),
            approaches=len(ended),
            error_norm=_ratio(error_px2, variance_px2),
            recent_error_norm=_ratio(_mean(self._squared_px2), variance_px2),
            auc=roc_curve(mono_px, stereo_px, self._positive_px).auc,
            collision_probability=self._collision_probability(samples, mono_threshold_px),
            novelty=_mean(self._novelty),
        )

    def _collision_probability(self, samples: Samples, mono_threshold_px: float) -> float:
        """The upper end of its interval."""
        per_approach = tally(samples, self._positive_px, mono_threshold_px)
        resampled = resample(per_approach, self._rng, RESAMPLES)
        _, upper = interval(resampled.collision_probability(self._n_positives))
        return float(upper[0])


def event_of(figures: TrustFigures) -> Event:
    """A change of status, with what it was judged by."""
    lost = figures.status is TrustStatus.STALE
    text = (
        f"mono is {figures.status.value}: error {figures.error_norm:.2f} of the variance, "
        f"lately {figures.recent_error_norm:.2f}, AUC {figures.auc:.2f}, collision probability "
        f"{figures.collision_probability:.1%}, novelty {figures.novelty:.1f}"
    )
    return Event(stamp_ns=figures.stamp_ns, severity="warning" if lost else "info", text=text)


def due_status(figures: TrustFigures, settings: TrustSettings, has_truth: bool) -> TrustStatus:
    """What the status should be by these figures, one step from ``figures.status``."""
    status = figures.status
    if status is TrustStatus.UNTRAINED:
        return TrustStatus.LEARNING if figures.frames else status
    if status is TrustStatus.TRUSTED:
        fits = _keeps(figures, settings) if has_truth else not figures.novelty > settings.novelty
        return status if fits else TrustStatus.STALE
    return TrustStatus.TRUSTED if has_truth and _earns(figures, settings) else status


def _earns(figures: TrustFigures, settings: TrustSettings) -> bool:
    """Every figure is known, and within its limit."""
    return (
        figures.approaches >= settings.least_approaches
        and figures.error_norm <= settings.error_norm
        and figures.recent_error_norm <= settings.recent_error_norm
        and figures.auc >= settings.auc
        and figures.collision_probability <= settings.collision_probability
    )


def _keeps(figures: TrustFigures, settings: TrustSettings) -> bool:
    """No figure that is known misses its limit by more than the slack.

    Mono turns before stereo would, so positives grow rare while it flies: with too few of them
    neither the ROC nor the risk says anything.
    """
    slack = settings.slack
    if (
        figures.error_norm > slack * settings.error_norm
        or figures.recent_error_norm > slack * settings.recent_error_norm
    ):
        return False
    return figures.approaches < settings.least_approaches or not (
        1.0 - figures.auc > slack * (1.0 - settings.auc)
        or figures.collision_probability > slack * settings.collision_probability
    )


class _Window:
    """The newest frames on which both cues knew λ, in one array: judging is a view of it."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._rows = np.empty((2 * size, 4))
        self._begin = self._end = 0

    def append(self, row: tuple[float, float, float, int]) -> None:
        """(stereo's λ, mono's, mono's as its threshold is compared with it, approach)."""
        if self._end == len(self._rows):
            kept = self._rows[self._begin :].copy()
            self._begin, self._end = 0, len(kept)
            self._rows[: self._end] = kept
        self._rows[self._end] = row
        self._end += 1
        self._begin = max(self._begin, self._end - self._size)

    def clear(self) -> None:
        self._begin = self._end = 0

    def columns(
        self,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """As ``append`` has them; the first three are views."""
        rows = self._rows[self._begin : self._end]
        return rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3].astype(np.int64)


def _mean(values: deque[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0 else math.nan
