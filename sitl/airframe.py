"""The flying body: JSBSim behind SI units. The only module that knows feet, pounds and slugs."""

import logging
import math
from os.path import isfile
from pathlib import Path
from typing import Final, NamedTuple

import jsbsim

from companion.kernel.errors import PlanError, SimulatorError
from companion.kernel.frames import Vector3

_log = logging.getLogger(__name__)

GRAVITY_M_S2: Final = 9.80665
AIRCRAFT_DIR: Final = Path(__file__).parent / "aircraft"

_M_PER_FT: Final = 0.3048
_FT_PER_M: Final = 1.0 / _M_PER_FT
_LBF_PER_N: Final = 1.0 / 4.4482216152605
_KG_PER_SLUG: Final = 14.593902937206
_TURN_RAD: Final = 2.0 * math.pi
_DIVERGED: Final = 1.0e6  # sum of feet and rad/s that no flight reaches; NaN fails the test as well

_STATE_PROPERTIES: Final = (
    "position/from-start-neu-n-ft",
    "position/from-start-neu-e-ft",
    "position/from-start-neu-u-ft",
    "velocities/v-north-fps",
    "velocities/v-east-fps",
    "velocities/v-down-fps",
    "attitude/phi-rad",
    "attitude/theta-rad",
    "attitude/psi-rad",
    "velocities/p-rad_sec",
    "velocities/q-rad_sec",
    "velocities/r-rad_sec",
    "accelerations/a-pilot-x-ft_sec2",
    "accelerations/a-pilot-y-ft_sec2",
    "accelerations/a-pilot-z-ft_sec2",
    "propulsion/thrust-norm[0]",
    "propulsion/thrust-norm[1]",
    "propulsion/thrust-norm[2]",
    "propulsion/thrust-norm[3]",
)

_RATE_GAINS: Final = (
    "fcs/roll-rate-p-1_s",
    "fcs/roll-rate-i-1_s2",
    "fcs/pitch-rate-p-1_s",
    "fcs/pitch-rate-i-1_s2",
    "fcs/yaw-rate-p-1_s",
)


class AirframeState(NamedTuple):
    """Truth. The position is relative to the centre of mass at rest on the floor at the start."""

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    euler_rad: Vector3
    """(roll, pitch, yaw), yaw in [-pi, pi)."""
    rates_frd_rad_s: Vector3
    specific_force_frd_m_s2: Vector3
    """What an accelerometer at the centre of mass reads: (0, 0, -9.8) at rest, 0 in free fall."""
    motors_norm: tuple[float, float, float, float]
    """Thrust of each rotor over its greatest, in PX4's order."""


class _Records(jsbsim.FGLogger):
    """Hands JSBSim's messages to logging, warnings and worse only; the banner goes nowhere."""

    def __init__(self) -> None:
        super().__init__()
        self._worth_it = False

    def set_level(self, level: jsbsim.LogLevel) -> None:
        self._worth_it = jsbsim.LogLevel.WARN <= level <= jsbsim.LogLevel.FATAL

    def message(self, message: str) -> None:
        if self._worth_it and message.strip():
            _log.warning("JSBSim: %s", message.strip())


class Airframe:
    """One aircraft of ``sitl/aircraft/``, standing on a floor at the start of its flat world.

    Setpoints of roll and pitch (rad), yaw rate (rad/s) and collective thrust (0..1 of all rotors'
    greatest) go to loops that run inside JSBSim, so that a step is one call.
    """

    def __init__(self, name: str, physics_hz: int, yaw_rad: float = 0.0) -> None:
        jsbsim.set_logger(_Records())
        self._fdm = fdm = jsbsim.FGFDMExec(None)
        fdm.set_debug_level(0)
        self._load(name)
        fdm.set_dt(1.0 / physics_hz)
        self.physics_hz = physics_hz
        self.ticks = 0
        self.rest_height_m = float(fdm["ground/rest-height-m"])
        """Height of the centre of mass above the floor while standing."""
        self.rotor_radius_m = float(fdm["propulsion/rotor-radius-m"])
        self._settle(yaw_rad)
        self._readers = tuple(self._node(path).get_double_value for path in _STATE_PROPERTIES)
        self._set_roll = self._node("fcs/roll-setpoint-rad").set_double_value
        self._set_pitch = self._node("fcs/pitch-setpoint-rad").set_double_value
        self._set_yaw_rate = self._node("fcs/yaw-rate-setpoint-rad_sec").set_double_value
        self._set_rates_given = self._node("fcs/rates-given").set_double_value
        self._set_roll_rate = self._node("fcs/roll-rate-command-rad_sec").set_double_value
        self._set_pitch_rate = self._node("fcs/pitch-rate-command-rad_sec").set_double_value
        self._set_collective = self._node("fcs/collective-norm").set_double_value
        self._set_spin = self._node("propulsion/spin").set_double_value
        self._set_thrust_limit = self._node("propulsion/thrust-limit-norm").set_double_value
        self._set_ground_effect = self._node("propulsion/ground-effect-norm").set_double_value
        self._set_wind = tuple(
            self._node(f"atmosphere/wind-{axis}-fps").set_double_value
            for axis in ("north", "east", "down")
        )
        self._set_push_norm = self._node("external_reactions/push/magnitude").set_double_value
        self._set_push = tuple(
            self._node(f"external_reactions/push/{axis}").set_double_value for axis in "xyz"
        )
        self._designed_gains = {path: float(fdm[path]) for path in _RATE_GAINS}
        self._run = fdm.run

    def _load(self, name: str) -> None:
        folder = AIRCRAFT_DIR / name
        if not isfile(folder / f"{name}.xml"):
            known = ", ".join(sorted(path.name for path in AIRCRAFT_DIR.iterdir() if path.is_dir()))
            raise PlanError(f"airframe {name!r}: no such aircraft; available: {known}")
        for set_path in (
            self._fdm.set_aircraft_path,
            self._fdm.set_engine_path,
            self._fdm.set_systems_path,
        ):
            set_path(str(AIRCRAFT_DIR))
        planet = str(folder / "planet.xml")
        if not (self._fdm.load_planet(planet, False) and self._fdm.load_model(name)):
            raise SimulatorError(f"airframe {name!r}: JSBSim cannot load {folder}")

    def _node(self, path: str) -> jsbsim.FGPropertyNode:
        """A handle on one property: three times faster than looking it up by name."""
        node = self._fdm.get_property_manager().get_node(path)
        if node is None:
            raise SimulatorError(f"airframe: the aircraft has no property {path}")
        return node

    def _settle(self, yaw_rad: float) -> None:
        """Starts where the feet carry the weight, so that nothing moves until the rotors do."""
        fdm = self._fdm
        fdm["ic/lat-geod-deg"] = 0.0
        fdm["ic/long-gc-deg"] = 0.0
        fdm["ic/h-agl-ft"] = self.rest_height_m * _FT_PER_M
        fdm["ic/psi-true-rad"] = yaw_rad % (2.0 * math.pi)
        if not fdm.run_ic():
            raise SimulatorError("JSBSim refused the initial state")

    @property
    def mass_kg(self) -> float:
        return float(self._fdm["inertia/mass-slugs"]) * _KG_PER_SLUG

    @property
    def hover_thrust_norm(self) -> float:
        """Collective thrust that carries the weight."""
        greatest_n = 4.0 * float(self._fdm["propulsion/rotor-thrust-max-n"])
        return self.mass_kg * GRAVITY_M_S2 / greatest_n

    def command(
        self,
        roll_rad: float,
        pitch_rad: float,
        yaw_rate_rad_s: float,
        thrust_norm: float,
        roll_rate_rad_s: float = math.nan,
        pitch_rate_rad_s: float = math.nan,
    ) -> None:
        """Setpoints of the inner loops, kept until the next call; rates go before angles."""
        if math.isnan(roll_rate_rad_s) or math.isnan(pitch_rate_rad_s):
            self._set_rates_given(0.0)
            self._set_roll(roll_rad)
            self._set_pitch(pitch_rad)
        else:
            self._set_rates_given(1.0)
            self._set_roll_rate(roll_rate_rad_s)
            self._set_pitch_rate(pitch_rate_rad_s)
        self._set_yaw_rate(yaw_rate_rad_s)
        self._set_collective(thrust_norm)

    def spin(self, turning: bool) -> None:
        """Whether the rotors are powered; powered ones never turn slower than idle."""
        self._set_spin(1.0 if turning else 0.0)

    def push(self, force_ned_n: Vector3) -> None:
        """A force from outside at the centre of mass, kept until the next call."""
        norm_n = math.hypot(*force_ned_n)
        self._set_push_norm(norm_n * _LBF_PER_N)
        if norm_n > 0.0:
            for set_axis, axis_n in zip(self._set_push, force_ned_n, strict=True):
                set_axis(axis_n / norm_n)

    def set_wind(self, wind_ned_m_s: Vector3) -> None:
        """Where the air moves to, everywhere the same, until the next call."""
        for set_axis, speed_m_s in zip(self._set_wind, wind_ned_m_s, strict=True):
            set_axis(speed_m_s * _FT_PER_M)

    def set_motor_efficiency(self, rotor: int, efficiency_norm: float) -> None:
        """Thrust that rotor 0..3 still makes, over that of a sound one."""
        self._fdm[f"fault/motor-efficiency[{rotor}]"] = efficiency_norm

    def set_thrust_limit(self, limit_norm: float) -> None:
        """The greatest thrust that a rotor can be asked for, over that with a full battery."""
        self._set_thrust_limit(limit_norm)

    def set_ground_effect(self, factor: float) -> None:
        """Lift of all rotors over that far from the ground, at the same speed."""
        self._set_ground_effect(factor)

    def scale_rate_loops(self, roll: float, pitch: float, yaw: float) -> None:
        """Makes the inner rate loops this many times as stiff as they were designed."""
        for path, gain in self._designed_gains.items():
            axis = path.removeprefix("fcs/").partition("-")[0]
            self._fdm[path] = gain * {"roll": roll, "pitch": pitch, "yaw": yaw}[axis]

    def step(self) -> None:
        """One step of the physics."""
        if not self._run():
            raise SimulatorError(f"JSBSim stopped at {self.time_s:.3f} s")
        self.ticks += 1

    @property
    def time_s(self) -> float:
        return self.ticks / self.physics_hz

    def read(self) -> AirframeState:
        """The state now. Raises SimulatorError when the integration has diverged."""
        (north, east, up, v_north, v_east, v_down, roll, pitch, yaw, p, q, r, a_x, a_y, a_z,
         *motors) = [read() for read in self._readers]  # fmt: skip
        if not abs(north + east + up + p + q + r) < _DIVERGED:
            raise SimulatorError(f"the flight dynamics diverged at {self.time_s:.3f} s")
        ft = _M_PER_FT
        return AirframeState(
            self.ticks / self.physics_hz,
            (north * ft, east * ft, self.rest_height_m - up * ft),
            (v_north * ft, v_east * ft, v_down * ft),
            (roll, pitch, yaw - _TURN_RAD if yaw >= math.pi else yaw),
            (p, q, r),
            (a_x * ft, a_y * ft, a_z * ft),
            (motors[0], motors[1], motors[2], motors[3]),
        )
