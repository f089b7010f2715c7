"""What must be so before the motors may start, or before a mode may be flown."""

import math
from typing import Final

from companion.kernel.messages import FlightMode
from sitl.autopilot.arming import arming_problems
from sitl.autopilot.battery import Battery
from sitl.autopilot.inputs import Inputs
from sitl.autopilot.interface import Estimate
from sitl.autopilot.parameters import Number
from sitl.autopilot.plans import Plans

_UPRIGHT_RAD: Final = math.radians(60.0)


class Readiness:
    """Asks those who know; changes nothing."""

    def __init__(
        self, parameters: dict[str, Number], battery: Battery, inputs: Inputs, plans: Plans
    ) -> None:
        self._parameters = parameters
        self._battery = battery
        self._inputs = inputs
        self._plans = plans

    def arming_problems(
        self, mode: FlightMode, estimate: Estimate, estimator_ready: bool
    ) -> list[str]:
        """Why arming for this mode is refused now; empty when it is not."""
        parameters, inputs = self._parameters, self._inputs
        tilt_rad = max(abs(estimate.roll_rad), abs(estimate.pitch_rad))
        return arming_problems(
            allowed=parameters["COM_ARMABLE"] == 1,
            estimator_ready=estimator_ready,
            battery_ok=self._battery.enough_to_arm,
            offboard_without_setpoints=mode is FlightMode.OFFBOARD and inputs.setpoints_lost,
            upright=tilt_rad < _UPRIGHT_RAD,
            ground_station_missed=parameters["NAV_DLL_ACT"] > 0 and inputs.ground_station_lost,
        )

    def available(self, mode: FlightMode, armed: bool, level_valid: bool) -> bool:
        """Whether this mode can be flown now; take-off and landing say so themselves."""
        if mode is FlightMode.OFFBOARD:
            lost = armed and self._inputs.setpoints_lost
            return not lost and (level_valid or self._inputs.by_attitude or not armed)
        if mode is FlightMode.ALTITUDE:
            return not self._inputs.sticks_lost
        if not level_valid:
            return False
        if mode is FlightMode.POSITION:
            return not self._inputs.sticks_lost
        if mode is FlightMode.MISSION:
            return bool(self._plans.mission.items) and self.mission_problem() is None
        return mode in (FlightMode.HOLD, FlightMode.RTL)

    def mission_problem(self) -> str | None:
        """A fence or parameter may have come after the mission that it forbids."""
        problem = self._plans.problem(self._plans.mission.items)
        return None if problem is None else f"Mission item {problem.item}: {problem.text}"
