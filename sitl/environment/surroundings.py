"""Acts on the airframe at the rate of control: wind and gusts, ground, weak motors and battery."""

from typing import Final

import numpy as np

from companion.kernel.frames import Vector3
from sitl.airframe import Airframe, AirframeState
from sitl.autopilot.autopilot import CONTROL_HZ, Autopilot
from sitl.environment.gusts import DrydenGusts
from sitl.settings import SitlSettings

_NEAREST_RADII: Final = 0.5  # closer to the ground than this the formula is not meant
_FULL_CELL_V: Final = 4.18  # at which the greatest thrust was measured


class Surroundings:
    """Parameters of the vehicle, keys of the plan and faults come together here."""

    def __init__(
        self,
        airframe: Airframe,
        autopilot: Autopilot,
        settings: SitlSettings,
        rng: np.random.Generator,
    ) -> None:
        self._airframe = airframe
        self._autopilot = autopilot
        self._limits_thrust = settings.battery.limits_thrust
        self._gusts = DrydenGusts(rng, 1.0 / CONTROL_HZ)
        self._gusty = self._lifted = False
        self.wind_ned_m_s: Vector3 = settings.wind_ned_m_s
        """Where the air moves to, in addition to what SIH_WIND_* make of it."""
        self.gusts_w20_m_s = settings.gusts_w20_m_s
        """As SIM_WIND_GUST; the greater one counts."""
        self.ground_effect_norm = settings.ground_effect_norm
        """As SIM_GND_EFFECT; the greater one counts."""
        self._applied = self._wanted()
        self._apply()

    def update(self, state: AirframeState) -> None:
        """``state`` is of now, in coordinates of home."""
        wanted = self._wanted()
        if wanted != self._applied:
            self._applied = wanted
            self._apply()
        parameters = self._autopilot.parameters
        if self.gusts_w20_m_s or parameters["SIM_WIND_GUST"] or self._gusty:
            self._blow(max(self.gusts_w20_m_s, parameters["SIM_WIND_GUST"]), state)
        if self.ground_effect_norm or parameters["SIM_GND_EFFECT"] or self._lifted:
            self._lift(max(self.ground_effect_norm, parameters["SIM_GND_EFFECT"]), state)
        if self._limits_thrust:
            full_v = parameters["BAT1_N_CELLS"] * _FULL_CELL_V
            share = self._autopilot.battery_voltage_v / full_v
            self._airframe.set_thrust_limit(min(1.0, share * share))

    def _wanted(self) -> tuple[object, ...]:
        """All that acts on the airframe and changes now and then."""
        parameters = self._autopilot.parameters
        return (
            parameters["MC_ROLLRATE_K"],
            parameters["MC_PITCHRATE_K"],
            parameters["MC_YAWRATE_K"],
            parameters["SIH_WIND_N"],
            parameters["SIH_WIND_E"],
            self.wind_ned_m_s,
            self._autopilot.failures.motor_efficiency_norm,
        )

    def _steady_ned_m_s(self) -> Vector3:
        """PX4 tells where wind comes from."""
        parameters = self._autopilot.parameters
        north_m_s, east_m_s, down_m_s = self.wind_ned_m_s
        return north_m_s - parameters["SIH_WIND_N"], east_m_s - parameters["SIH_WIND_E"], down_m_s

    def _apply(self) -> None:
        parameters = self._autopilot.parameters
        self._airframe.scale_rate_loops(
            parameters["MC_ROLLRATE_K"], parameters["MC_PITCHRATE_K"], parameters["MC_YAWRATE_K"]
        )
        self._airframe.set_wind(self._steady_ned_m_s())
        efficiency_norm = self._autopilot.failures.motor_efficiency_norm
        for rotor, left_norm in enumerate(efficiency_norm):
            self._airframe.set_motor_efficiency(rotor, left_norm)

    def _blow(self, w20_m_s: float, state: AirframeState) -> None:
        steady = self._steady_ned_m_s()
        self._gusty = w20_m_s > 0.0
        if not self._gusty:
            self._airframe.set_wind(steady)
            return
        height_m = -state.position_ned_m[2]
        north, east, down = self._gusts.step(w20_m_s, height_m, steady, state.velocity_ned_m_s)
        self._airframe.set_wind((steady[0] + north, steady[1] + east, steady[2] + down))

    def _lift(self, effect_norm: float, state: AirframeState) -> None:
        self._lifted = effect_norm > 0.0
        hub_m = self._airframe.rest_height_m - state.position_ned_m[2]
        more_norm = ground_effect_norm(hub_m, self._airframe.rotor_radius_m) - 1.0
        self._airframe.set_ground_effect(1.0 + effect_norm * more_norm)


def ground_effect_norm(height_m: float, radius_m: float) -> float:
    """Thrust at this height of the rotor over that far up, at the same speed.

    I. C. Cheeseman, W. E. Bennett, The effect of the ground on a helicopter rotor in forward
    flight, ARC R&M 3021 (1955): 1 / (1 - (R / 4 z)^2), for one rotor in hover.
    """
    near = radius_m / (4.0 * max(height_m, _NEAREST_RADII * radius_m))
    return 1.0 / (1.0 - near * near)
