"""What a flight is judged by: turns, approaches, overrides, and mono against stereo.

One account per phase; the test phase is what the paper's tables report.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.flying.switch import Choice
from companion.judging.performance import OnlinePerformance, roc_curve
from companion.judging.risk import Samples
from companion.kernel.messages import BehaviourState, Cue, Percept, Phase

STEREO_CUES = (Cue.STEREO, Cue.FUSED)
"""Cues that stop with stereo."""
NO_APPROACH = 0
"""Number of the approach of a frame that belongs to none: the vehicle was turning."""


class Score(NamedTuple):
    """Mono's estimate against stereo's λ as the truth (paper section III-E); NaN undefined."""

    mse: float
    tpr: float
    fpr: float
    auc: float


class Account:
    """The running totals of one phase."""

    def __init__(self, positive_threshold_px: float) -> None:
        self.stereo_flight_s = 0.0
        self.mono_flight_s = 0.0
        self.turns = 0
        self.stereo_approaches = 0
        self.mono_approaches = 0
        self.overrides = 0
        self._performance = OnlinePerformance(positive_threshold_px)
        self._stereo_px: list[float] = []
        self._mono_px: list[float] = []
        self._cautious_px: list[float] = []
        """Mono's λ as its threshold is compared with it."""
        self._approach: list[int] = []

    @property
    def approaches(self) -> int:
        return self.stereo_approaches + self.mono_approaches

    def add_flight(self, cue: Cue, duration_s: float) -> None:
        if cue in STEREO_CUES:
            self.stereo_flight_s += duration_s
        elif cue is Cue.MONO:
            self.mono_flight_s += duration_s

    def add_approach(self, cue: Cue) -> None:
        if cue in STEREO_CUES:
            self.stereo_approaches += 1
        elif cue is Cue.MONO:
            self.mono_approaches += 1

    def add_estimate(
        self, percept: Percept, mono_threshold_px: float, caution_px: float, in_approach: bool
    ) -> None:
        """Only frames on which both cues know λ count."""
        if math.isnan(percept.stereo_px) or math.isnan(percept.mono_px):
            return
        self._performance.update(percept.mono_px, percept.stereo_px, mono_threshold_px - caution_px)
        self._stereo_px.append(percept.stereo_px)
        self._mono_px.append(percept.mono_px)
        self._cautious_px.append(percept.mono_px + caution_px)
        self._approach.append(self.approaches if in_approach else NO_APPROACH)

    def estimates(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(stereo_px, mono_px) of the frames counted."""
        return np.array(self._stereo_px), np.array(self._mono_px)

    def approach_samples(self) -> Samples:
        """The frames counted that belong to an approach, numbered from 1 within the phase."""
        approach = np.array(self._approach, dtype=np.int64)
        flown = approach != NO_APPROACH
        stereo_px, cautious_px = np.array(self._stereo_px), np.array(self._cautious_px)
        return Samples(stereo_px[flown], cautious_px[flown], approach[flown])

    def score(self) -> Score:
        """Positives are frames with stereo λ above stereo's threshold."""
        online = self._performance
        curve = roc_curve(self._mono_px, self._stereo_px, online.positive_threshold_px)
        return Score(online.mse_px2, online.tpr, online.fpr, curve.auc)


class Scorecard:
    """Counts events as frames go by. An override event counts once per approach."""

    def __init__(self, positive_threshold_px: float) -> None:
        self.accounts = {phase: Account(positive_threshold_px) for phase in Phase}
        self._phase: Phase | None = None
        self._state: BehaviourState | None = None
        self._stamp_ns: int | None = None
        self._overriding = False
        self._override_counted = False

    def approach_samples(self, phases: Sequence[Phase]) -> Samples:
        """Of these phases together; no two of their approaches share a number."""
        parts = [self.accounts[phase].approach_samples() for phase in phases]
        first = np.cumsum([0, *(self.accounts[phase].approaches for phase in phases)])
        return Samples(
            np.concatenate([part.stereo_px for part in parts]),
            np.concatenate([part.mono_px for part in parts]),
            np.concatenate([part.approach + n for part, n in zip(parts, first[:-1], strict=True)]),
        )

    def record(
        self,
        percept: Percept,
        phase: Phase,
        choice: Choice,
        state: BehaviourState,
        mono_threshold_px: float,
        caution_px: float = 0.0,
    ) -> Account:
        """One frame on; returns the account of its phase. ``caution_px``: see flying.switch."""
        account = self.accounts[phase]
        if self._stamp_ns is not None:
            account.add_flight(choice.cue, (percept.stamp_ns - self._stamp_ns) * 1e-9)
        straight = state is BehaviourState.STRAIGHT
        if straight and (self._state is not BehaviourState.STRAIGHT or phase is not self._phase):
            account.add_approach(choice.cue)
            self._override_counted = False
        # The frame that ends an approach belongs to it: on it the obstacle was detected.
        goes_on = self._state is BehaviourState.STRAIGHT and phase is self._phase
        account.add_estimate(percept, mono_threshold_px, caution_px, straight or goes_on)
        if self._state is BehaviourState.STRAIGHT and not straight:
            account.turns += 1
        if choice.override and not self._overriding and not self._override_counted:
            account.overrides += 1
            self._override_counted = True
        self._overriding = choice.override
        self._phase, self._state, self._stamp_ns = phase, state, percept.stamp_ns
        return account
