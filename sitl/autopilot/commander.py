"""Who decides: arming, the mode that was commanded, and the failsafes that overrule it."""

import math
from collections import deque
from collections.abc import Callable
from typing import Final

from companion.kernel.messages import FlightMode
from sitl.autopilot.arming import Arming
from sitl.autopilot.battery import Battery
from sitl.autopilot.estimator import Estimator
from sitl.autopilot.failsafe import Failsafe, Situation
from sitl.autopilot.flight import Flight
from sitl.autopilot.ground import GroundState
from sitl.autopilot.inputs import Inputs
from sitl.autopilot.interface import Ack, Estimate, Severity, StatusText
from sitl.autopilot.parameters import Number
from sitl.autopilot.plans import Plans
from sitl.autopilot.reactions import ACTION_MODES, Action
from sitl.autopilot.readiness import Readiness
from sitl.autopilot.status import Verdict

_TEXTS_KEPT: Final = 500  # while no link takes them; then the oldest go


class Commander:
    """``watch`` is to be called at every step, before the mode of now is flown."""

    def __init__(
        self,
        parameters: dict[str, Number],
        now_s: Callable[[], float],
        estimator: Estimator,
        battery: Battery,
        inputs: Inputs,
        plans: Plans,
        flight: Flight,
    ) -> None:
        self._parameters = parameters
        self._now_s = now_s
        self._estimator = estimator
        self._battery = battery
        self._inputs = inputs
        self._plans = plans
        self._flight = flight
        self._readiness = Readiness(parameters, battery, inputs, plans)
        self._arming = Arming(parameters)
        self._failsafe = Failsafe(parameters, inputs)
        self._texts: deque[StatusText] = deque(maxlen=_TEXTS_KEPT)
        self._ready = False
        self._intended = FlightMode.HOLD

    # -- what is so ----------------------------------------------------------------------------

    @property
    def armed(self) -> bool:
        return self._arming.armed

    @property
    def mode(self) -> FlightMode:
        """The commanded mode, unless a failsafe has taken over."""
        return ACTION_MODES.get(self._failsafe.action, self._intended)

    @property
    def verdict(self) -> Verdict:
        return Verdict(
            armed=self._arming.armed,
            mode=self.mode,
            intended_mode=self._intended,
            ready_to_arm=self._ready,
            failsafe=self._failsafe.active,
        )

    @property
    def may_lift_off(self) -> bool:
        return self._arming.spooled_up(self._estimator.estimate.time_s) and not (
            self._intended is FlightMode.OFFBOARD and self._inputs.setpoints_lost
        )

    # -- what is said --------------------------------------------------------------------------

    def announce(self, severity: Severity, text: str) -> None:
        self._texts.append(StatusText(self._now_s(), severity, text))

    def drain_status_texts(self) -> list[StatusText]:
        texts = list(self._texts)
        self._texts.clear()
        return texts

    # -- what is commanded ---------------------------------------------------------------------

    def arm(self, force: bool) -> Ack:
        if self._arming.armed:
            return Ack.ACCEPTED
        problems = self._arming_problems()
        if problems and not force:
            self.announce(Severity.CRITICAL, f"Arming denied: {', '.join(problems)}")
            return Ack.TEMPORARILY_REJECTED
        self._arming.arm(self._now_s())
        self.announce(Severity.INFO, "Armed by external command")
        return Ack.ACCEPTED

    def disarm(self, force: bool) -> Ack:
        if self._flight.airborne and not force:
            self.announce(Severity.CRITICAL, "Disarming denied: not landed")
            return Ack.TEMPORARILY_REJECTED
        if self._arming.armed:
            self._stop_motors("Disarmed by external command")
        return Ack.ACCEPTED

    def take_off(self, height_m: float) -> Ack:
        wanted_m = self._parameters["MIS_TAKEOFF_ALT"] if math.isnan(height_m) else height_m
        if not 0.0 < wanted_m < math.inf:
            return Ack.DENIED
        again = wanted_m == self._flight.take_off_height_m and self._intended is FlightMode.TAKEOFF
        if again and self._failsafe.action <= Action.WARN:
            return Ack.ACCEPTED
        if self._flight.airborne:
            return self.refuse(FlightMode.TAKEOFF)
        self._flight.take_off_height_m = wanted_m
        return self.intend(FlightMode.TAKEOFF)

    def land(self) -> Ack:
        return self.intend(FlightMode.LAND) if self._arming.armed else Ack.ACCEPTED

    def set_mode(self, mode: FlightMode) -> Ack:
        if mode is FlightMode.LAND:
            return self.land()
        if mode is FlightMode.TAKEOFF:
            return self.take_off(math.nan)
        if self._readiness.available(mode, self._arming.armed, self._estimator.level_valid):
            return self.intend(mode)
        problem = self._readiness.mission_problem() if mode is FlightMode.MISSION else None
        if problem is not None:
            self.announce(Severity.CRITICAL, problem)
        return self.refuse(mode)

    def intend(self, mode: FlightMode) -> Ack:
        """Flies this from now on; whoever commands has the vehicle back from a failsafe."""
        if mode is FlightMode.MISSION and self._plans.mission.complete:
            self._plans.mission.restart()
        self._intended = mode
        self._failsafe.overrule()
        return Ack.ACCEPTED

    def refuse(self, mode: FlightMode) -> Ack:
        self.announce(Severity.CRITICAL, f"Mode {mode.value} is not available now")
        return Ack.TEMPORARILY_REJECTED

    def reboot(self) -> Ack:
        if self._arming.armed:
            self.announce(Severity.CRITICAL, "Reboot denied: armed")
            return Ack.TEMPORARILY_REJECTED
        self._texts.clear()
        self._estimator.restart(self._now_s())
        self._inputs.forget()
        self._ready, self._intended = False, FlightMode.HOLD
        return Ack.ACCEPTED

    def terminate(self, reason: str) -> None:
        """Motors off at once, wherever the vehicle is."""
        if self._arming.armed:
            self.announce(Severity.CRITICAL, f"Flight terminated: {reason}")
            self._stop_motors("Disarmed by failure detector")

    # -- what it sees for itself ---------------------------------------------------------------

    def watch(self) -> None:
        """Feels the ground, lets the failsafes judge, goes on to the mode that follows."""
        if self._arming.armed:
            self._feel_ground(self._estimator.estimate)
            if self._flight.airborne:
                self._judge(self._estimator.estimate)
                self._heed_pilot()
        if self._arming.armed:
            self._go_on()
        else:
            self._announce_readiness()

    def _feel_ground(self, estimate: Estimate) -> None:
        """Reports lift-off and touch-down, and disarms what has stood for long enough."""
        ground, before = self._flight.ground, self._flight.ground.state
        self._flight.feel_ground(estimate)
        if before is GroundState.LIFTING_OFF and ground.state is GroundState.FLYING:
            self._arming.left_ground()
            self.announce(Severity.INFO, "Takeoff detected")
        elif ground.standing and before is not GroundState.STANDING:
            self._arming.touched_ground(estimate.time_s)
            self.announce(Severity.INFO, "Landing detected")
        if reason := self._arming.reason_to_disarm(estimate.time_s, ground.standing):
            self._stop_motors(reason)

    def _judge(self, estimate: Estimate) -> None:
        before = self._failsafe.action
        inside = self._plans.inside_fence(estimate.position_ned_m)
        causes = self._failsafe.update(
            Situation(
                self._intended,
                estimate,
                self._battery.charge_norm,
                inside,
                self._estimator.level_valid,
                self._intended is FlightMode.OFFBOARD and self._inputs.by_attitude,
            )
        )
        if (words := self._failsafe.words(before)) is not None:
            self.announce(Severity.CRITICAL, words)
        for cause in causes:
            self.announce(Severity.WARNING, cause)
        if self._failsafe.action is Action.TERMINATE:
            self.terminate(", ".join(self._failsafe.causes))

    def _heed_pilot(self) -> None:
        if self._inputs.pilot_takes(self.mode):
            self.intend(FlightMode.POSITION)
            self.announce(Severity.INFO, "Pilot took over using sticks")

    def _go_on(self) -> None:
        """Enters the mode that follows on a take-off or a mission, once that is done."""
        following = self._flight.next_mode
        if following is None or self.mode is not self._intended:
            return
        if self._intended is FlightMode.MISSION:
            self.announce(Severity.INFO, "Mission finished")
        self._intended = following

    def _announce_readiness(self) -> None:
        ready = not self._arming_problems()
        if ready and not self._ready:
            self.announce(Severity.INFO, "Ready for takeoff!")
        self._ready = ready

    def _arming_problems(self) -> list[str]:
        estimate = self._estimator.estimate
        ready = self._estimator.ready(estimate.time_s)
        return self._readiness.arming_problems(self._intended, estimate, ready)

    def _stop_motors(self, reason: str) -> None:
        self.announce(Severity.INFO, reason)
        self._arming.disarm()
        self._flight.stop()
        self._failsafe.reset()
        self._intended = FlightMode.HOLD
