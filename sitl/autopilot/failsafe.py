"""What the autopilot does by itself when something is missing, empty or out of bounds.

As in PX4, the worst reaction of all causes is taken; most let the vehicle hold for COM_FAIL_ACT_T
first; a mode that is commanded meanwhile takes the vehicle back until something new goes wrong.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from companion.kernel.messages import FlightMode
from sitl.autopilot.inputs import Inputs
from sitl.autopilot.interface import Estimate
from sitl.autopilot.parameters import Number
from sitl.autopilot.reactions import (
    Action,
    Reaction,
    on_breach,
    on_link_loss,
    on_low_battery,
    on_offboard_loss,
    on_position_loss,
    without_position,
)

_DELAY_REGROWTH: Final = 0.25  # s of delay won back per second without one, as PX4
_NO_MANUAL_CONTROL: Final = 4  # of COM_RC_IN_MODE
_EXCEPTION_BITS: Final[Mapping[FlightMode, int]] = {
    FlightMode.MISSION: 1,
    FlightMode.HOLD: 2,
    FlightMode.TAKEOFF: 2,
    FlightMode.LAND: 2,
    FlightMode.RTL: 2,
    FlightMode.OFFBOARD: 4,
}
"""Of COM_RCL_EXCEPT: the modes that go on without sticks."""


class Situation(NamedTuple):
    """What the failsafes look at; only asked for while flying."""

    mode: FlightMode
    """That was commanded, whatever is flown."""
    estimate: Estimate
    battery_norm: float
    inside_fence: bool
    level_valid: bool = True
    """Whether the estimator knows where the vehicle is."""
    by_attitude: bool = False
    """Whether offboard mode flies an attitude, which needs no place."""


class Failsafe:
    """Watches one flight. ``causes`` names what is wrong, ``action`` what is done about it."""

    def __init__(self, parameters: dict[str, Number], inputs: Inputs) -> None:
        self._parameters = parameters
        self._inputs = inputs
        self._time_s = math.nan
        self.reset()

    def reset(self) -> None:
        """To be called when disarmed."""
        self.action = Action.NONE
        self.causes: dict[str, Reaction] = {}
        self._judged: dict[str, Reaction] = {}
        self._taken_over = self._sticks_used = False
        self._tilted_since_s = math.nan
        self.hold_left_s = 0.0
        """How long it still holds before it acts."""
        self._delay_s = math.inf

    @property
    def active(self) -> bool:
        return self.action > Action.WARN

    def overrule(self) -> None:
        """A mode was commanded: whoever did so has the vehicle back."""
        self.causes = {
            text: reaction for text, reaction in self.causes.items() if text in self._judged
        }
        self._taken_over = self._taken_over or Action.WARN < self.action < Action.TERMINATE

    def update(self, now: Situation) -> list[str]:
        """Judges the situation; returns the causes that are new."""
        step_s = self._step_s(now.estimate.time_s)
        self.hold_left_s = max(0.0, self.hold_left_s - step_s)
        self._judged = {
            text: reaction
            for text, reaction in self._judge(now)
            if reaction.action is not Action.NONE
        }
        new = [text for text in self._judged if text not in self.causes]
        lasting = {text: r for text, r in self.causes.items() if r.lasting and not self._taken_over}
        self.causes = lasting | self._judged
        self._delay_s = min(self._delay_s, self._parameters["COM_FAIL_ACT_T"])
        for text in new:
            self._begin(self.causes[text])
        if self.action > Action.HOLD or self._taken_over:
            self.hold_left_s = 0.0
        self.action = self._select(now.mode, step_s)
        if not now.level_valid:
            self.action = without_position(self.action)
        return new

    def words(self, before: Action) -> str | None:
        """PX4's words if it does more than ``before``."""
        if not self.active or self.action <= before:
            return None
        wait = f", entering Hold for {self.hold_left_s:.0f} seconds"
        return f"Failsafe activated{wait if self.hold_left_s > 0.0 else ''}"

    def _step_s(self, time_s: float) -> float:
        """Since the last update; 0 at the first."""
        before_s, self._time_s = self._time_s, time_s
        return 0.0 if math.isnan(before_s) else time_s - before_s

    def _begin(self, reaction: Reaction) -> None:
        if reaction.action >= Action.HOLD:
            self._taken_over = False
        if reaction.delayed and reaction.action > Action.WARN and self.hold_left_s == 0.0:
            self.hold_left_s = self._delay_s

    def _select(self, mode: FlightMode, step_s: float) -> Action:
        """The action of now; a delay that is used up grows back slowly."""
        worst = max((cause.action for cause in self.causes.values()), default=Action.NONE)
        self._taken_over = self._taken_over and Action.WARN < worst < Action.TERMINATE
        if self._taken_over or (worst is Action.RETURN and mode is FlightMode.LAND):
            worst = min(worst, Action.WARN)
        delaying = self.hold_left_s > 0.0 and Action.WARN < worst < Action.TERMINATE
        self._delay_s += -step_s if delaying else step_s * _DELAY_REGROWTH
        self._delay_s = max(0.0, self._delay_s)
        return Action.HOLD if delaying else worst

    def _judge(self, now: Situation) -> Iterator[tuple[str, Reaction]]:
        parameters, inputs = self._parameters, self._inputs
        self._sticks_used = self._sticks_used or not inputs.sticks_lost
        if now.mode is FlightMode.OFFBOARD and inputs.setpoints_lost:
            value = int(parameters["COM_OBL_RC_ACT"])
            yield "No offboard setpoints", on_offboard_loss(value, not inputs.sticks_lost)
        if inputs.sticks_lost and self._needs_sticks(now.mode):
            yield "Manual control lost", on_link_loss(int(parameters["NAV_RCL_ACT"]))
        if not now.level_valid and self._needs_place(now):
            by_hand = now.mode is FlightMode.POSITION and not inputs.sticks_lost
            value = int(parameters["COM_POSCTL_NAVL"])
            yield "No valid position estimate", on_position_loss(value, by_hand)
        if inputs.ground_station_lost and now.mode is not FlightMode.LAND:
            yield "Ground station lost", on_link_loss(int(parameters["NAV_DLL_ACT"]))
        yield from self._judge_battery(now.battery_norm)
        if not now.inside_fence:
            yield "Geofence exceeded", on_breach(int(parameters["GF_ACTION"]))
        if self._tumbles(now.estimate):
            broken = parameters["CBRK_FLIGHTTERM"] != 0
            action = Action.WARN if broken else Action.TERMINATE
            yield "Attitude failure detected", Reaction(action, delayed=False)

    def _needs_place(self, now: Situation) -> bool:
        return not (now.mode is FlightMode.ALTITUDE or now.by_attitude)

    def _needs_sticks(self, mode: FlightMode) -> bool:
        """Sticks that were never used in this flight are optional."""
        if self._parameters["COM_RC_IN_MODE"] == _NO_MANUAL_CONTROL:
            return False
        excepted = int(self._parameters["COM_RCL_EXCEPT"]) & _EXCEPTION_BITS.get(mode, 0)
        return self._sticks_used and not excepted

    def _judge_battery(self, charge_norm: float) -> Iterator[tuple[str, Reaction]]:
        parameters = self._parameters
        value = int(parameters["COM_LOW_BAT_ACT"])
        if charge_norm <= parameters["BAT_EMERGEN_THR"]:
            yield "Dangerous battery level", on_low_battery(value, emergency=True)
        elif charge_norm <= parameters["BAT_CRIT_THR"]:
            yield "Critical battery level", on_low_battery(value, emergency=False)
        elif charge_norm <= parameters["BAT_LOW_THR"]:
            yield "Low battery level", Reaction(Action.WARN)

    def _tumbles(self, now: Estimate) -> bool:
        """PX4's failure detector: tilted beyond a limit for longer than a time; 0 is no limit."""
        parameters = self._parameters
        tilts = (("FD_FAIL_R", now.roll_rad), ("FD_FAIL_P", now.pitch_rad))
        names = [
            name for name, angle_rad in tilts if 0 < parameters[name] < abs(math.degrees(angle_rad))
        ]
        if not names:
            self._tilted_since_s = math.nan
            return False
        if math.isnan(self._tilted_since_s):
            self._tilted_since_s = now.time_s
        tilted_s = now.time_s - self._tilted_since_s
        return any(tilted_s >= parameters[f"{name}_TTRI"] for name in names)
