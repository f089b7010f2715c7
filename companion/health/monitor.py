"""The cameras' health over a flight: frame by frame what may be used, and events when it changes.

A frame is used in four steps: ``look`` at the eyes, match the two that are sound, ``compare`` the
matches, and, once stereo and one eye have both spoken, ``conclude``.

A frame with a sign of a fault is not used at all, also before the fault is confirmed; what is
healthy therefore passes unchanged.
"""

import math
from typing import NamedTuple

from companion.health.agreement import Agreement
from companion.health.eyes import Eyes, Sign
from companion.health.pairing import pairing, sign_of
from companion.health.timing import FrameClock
from companion.health.verdicts import Debounce, HealthSettings
from companion.health.words import PLACES, State, events_of, faults_in_words, return_of_stereo
from companion.kernel.messages import (
    Availability,
    CameraFault,
    Event,
    Health,
    Percept,
    StereoFrame,
)
from companion.vision.stereo import Matches


class Look(NamedTuple):
    """Which images of this frame may be used: no sign of a fault in them, nor shortly before."""

    left: bool
    right: bool

    @property
    def both(self) -> bool:
        return self.left and self.right


class Outlook(NamedTuple):
    """What may be flown on, and what has to be said: events and a record where it has changed."""

    available: Availability
    events: tuple[Event, ...] = ()
    record: Health | None = None


class CameraHealth:
    """One stereo camera. All times are those of the frames, but for their arrival."""

    def __init__(self, settings: HealthSettings, stale_after_s: float = math.inf) -> None:
        """A frame that comes later than ``stale_after_s`` is not flown on."""
        self.n_named = 0
        """Faults that were confirmed so far."""
        self._eyes = Eyes()
        self._places = {place: Debounce(settings) for place in PLACES}
        self._clock = FrameClock()
        self._stale_after_s = stale_after_s
        self._agreement = Agreement(settings.agree_s)
        self._timing_sign: Sign | None = None
        self._available = Availability()
        self._told = State()

    def look(self, frame: StereoFrame, *arrived_s: float) -> Look:
        """``arrived_s``: when the frame came, by each clock that there is (see FrameClock)."""
        self._timing_sign = self._clock.tick(frame, *arrived_s)
        left, right = self._eyes.look(frame.left, frame.right, self._clock.period_s)
        for place, sign in (("left", left), ("right", right), ("timing", self._timing_sign)):
            self._places[place].update(sign, self._clock.period_s)
        return Look(
            left is None and self._places["left"].fault is None,
            right is None and self._places["right"].fault is None,
        )

    def compare(self, matches: Matches, valid_norm: float) -> bool:
        """Whether the matches of this frame are those of a sound pair."""
        if _out_of_step(self._timing_sign and self._timing_sign.fault):
            return False
        sign = sign_of(pairing(matches, valid_norm), valid_norm, matches.infinity_px)
        self._places["pair"].update(sign, self._clock.period_s)
        return sign is None

    @property
    def available(self) -> Availability:
        """What may be flown on, but for the age of a frame."""
        return self._available

    @property
    def faults(self) -> str:
        """Those confirmed, in words; "" for none."""
        return faults_in_words(self._told)

    def conclude(self, percept: Percept, trusted: bool) -> Outlook:
        """``trusted``: the learned estimate may fly alone, and judge whether stereo may return."""
        was, told = self._available, self._told
        state = State(*(self._places[place].fault for place in PLACES))
        sound = not (state.left or state.right or state.pair or _out_of_step(state.timing))
        stereo = sound and (was.stereo or not trusted or self._agrees(percept))
        if not sound or stereo:
            self._agreement.restart()
        if stereo:
            self._agreement.learn(percept, self._clock.period_s)
        self._available = Availability(stereo, state.left is None, state.right is None)
        self._told = state
        self.n_named += sum(
            now is not None and now is not before for now, before in zip(state, told, strict=True)
        )
        if (state, self._available) == (told, was):
            return Outlook(self._usable())
        return Outlook(self._usable(), self._events(percept, told, was, trusted), self._record())

    def _agrees(self, percept: Percept) -> bool:
        return self._agreement.reached(percept, self._clock.period_s)

    def _usable(self) -> Availability:
        """Old frames are as good as none, but say nothing about the eyes."""
        if self._clock.late_s > self._stale_after_s:
            return Availability(stereo=False, left=False, right=False)
        return self._available

    def _events(
        self, percept: Percept, told: State, was: Availability, trusted: bool
    ) -> tuple[Event, ...]:
        evidence = {place: debounce.evidence for place, debounce in self._places.items()}
        stamp_ns = percept.stamp_ns
        events = events_of(stamp_ns, self._told, told, evidence, self._available, trusted)
        if self._available.stereo and not was.stereo:
            events += (return_of_stereo(stamp_ns, self._agreement.difference_px),)
        return events

    def _record(self) -> Health:
        evidence = {
            place: debounce.evidence if debounce.fault else ""
            for place, debounce in self._places.items()
        }
        left, right, pair, timing = (fault.value if fault else "" for fault in self._told)
        return Health(
            stamp_ns=self._clock.stamp_ns,
            stereo=self._available.stereo,
            left=self._available.left,
            right=self._available.right,
            left_fault=left,
            right_fault=right,
            pair_fault=pair,
            timing_fault=timing,
            left_evidence=evidence["left"],
            right_evidence=evidence["right"],
            pair_evidence=evidence["pair"],
            timing_evidence=evidence["timing"],
        )


def _out_of_step(fault: CameraFault | None) -> bool:
    """Late frames still match each other; those of two moments do not."""
    return fault is CameraFault.DESYNCHRONISED
