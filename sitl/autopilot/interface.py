"""What the autopilot takes from a link and tells it; no MAVLink in here."""

from enum import IntEnum
from typing import NamedTuple, Protocol

from companion.kernel.frames import Vector3
from companion.kernel.messages import NAN, FlightMode, LandedState
from sitl.autopilot.estimation.quality import Quality
from sitl.autopilot.estimation.vision_sample import VisionSample
from sitl.autopilot.mission import MissionProgress
from sitl.autopilot.plans import Plans
from sitl.sensors.suite import Sensors

NAN3: Vector3 = (NAN, NAN, NAN)


class Ack(IntEnum):
    """Verdict on a command, with MAVLink's numbers (MAV_RESULT)."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Severity(IntEnum):
    """MAV_SEVERITY."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    INFO = 6


class StatusText(NamedTuple):
    time_s: float
    severity: Severity
    text: str


class OffboardSetpoint(NamedTuple):
    """One SET_POSITION_TARGET_LOCAL_NED in NED, body frames already turned to NED by the link.

    NaN means "not controlled"; a yaw of NaN with a yaw rate of NaN holds the heading.
    """

    position_ned_m: Vector3 = NAN3
    velocity_ned_m_s: Vector3 = NAN3
    yaw_rad: float = NAN
    yaw_rate_rad_s: float = NAN
    acceleration_ned_m_s2: Vector3 = NAN3


class AttitudeSetpoint(NamedTuple):
    """One SET_ATTITUDE_TARGET; NaN means "not controlled".

    Roll and pitch are flown as rates where the angles are NaN.
    """

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    rates_frd_rad_s: Vector3
    thrust_norm: float
    """Collective thrust as a share of all rotors' greatest."""


class ManualInput(NamedTuple):
    """Deflections of the sticks, from -1 to 1; 0 is centred."""

    forward_norm: float
    right_norm: float
    up_norm: float
    yaw_norm: float


class OrbitRequest(NamedTuple):
    """NaN, or -1 for the behaviour, leaves a value as it was."""

    radius_m: float = NAN
    """Positive: clockwise seen from above."""
    speed_m_s: float = NAN
    yaw_behaviour: int = -1
    centre_ned_m: Vector3 = NAN3
    """The height to fly at is its third."""


class OrbitStatus(NamedTuple):
    """What links report of an orbit."""

    radius_m: float
    """Signed as in the request."""
    centre_ned_m: Vector3


class Estimate(NamedTuple):
    """The state estimate: truth plus modelled drift and noise."""

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    rates_frd_rad_s: Vector3
    acceleration_frd_m_s2: Vector3
    """Specific force: what an accelerometer reads (0, 0, -9.8 at rest)."""


class VehicleStatus(NamedTuple):
    """What the link reports beside the estimate."""

    armed: bool
    mode: FlightMode
    landed_state: LandedState
    ready_to_arm: bool
    failsafe: bool
    battery_voltage_v: float
    battery_current_a: float
    battery_norm: float
    motors_norm: tuple[float, float, float, float]
    position_setpoint_ned_m: Vector3
    velocity_setpoint_ned_m_s: Vector3
    yaw_setpoint_rad: float
    thrust_norm: float
    roll_setpoint_rad: float
    pitch_setpoint_rad: float
    yaw_rate_setpoint_rad_s: float
    mission: MissionProgress
    intended_mode: FlightMode
    """That was commanded; a failsafe may fly another."""
    home_ned_m: Vector3
    home_yaw_rad: float
    gyro_vibration_rad_s: float
    acceleration_vibration_m_s2: float
    orbit: OrbitStatus | None
    """None while none is flown."""


class AutopilotPort(Protocol):
    """The autopilot as its links see it. All calls happen between two steps of the world."""

    @property
    def estimate(self) -> Estimate: ...

    @property
    def status(self) -> VehicleStatus: ...

    @property
    def parameters(self) -> dict[str, float | int]:
        """PX4 names; int stays INT32 and float REAL32 on the wire."""
        ...

    def set_parameter(self, name: str, value: float) -> bool:
        """False for an unknown name or a value out of range."""
        ...

    def arm(self, force: bool = False) -> Ack: ...

    def disarm(self, force: bool = False) -> Ack: ...

    def take_off(self, height_m: float = NAN) -> Ack:
        """NaN climbs to MIS_TAKEOFF_ALT above home."""
        ...

    def land(self) -> Ack: ...

    def set_mode(self, mode: FlightMode) -> Ack: ...

    def set_offboard_setpoint(self, setpoint: OffboardSetpoint | AttitudeSetpoint) -> None:
        """Stamped with the world's time; feeds the offboard-loss timer."""
        ...

    def set_manual_input(self, sticks: ManualInput) -> None:
        """Stamped likewise; feeds the timer of lost sticks."""
        ...

    def take_vision(self, sample: VisionSample) -> None:
        """A pose or velocity that a client has measured; used at the next update."""
        ...

    @property
    def sensors(self) -> Sensors: ...

    @property
    def quality(self) -> Quality:
        """What the estimator says of its estimate."""
        ...

    def hear_ground_station(self) -> None:
        """A ground station's heartbeat; feeds the timer of the data link."""
        ...

    @property
    def plans(self) -> Plans:
        """Mission, fence and rally points."""
        ...

    def announce(self, severity: Severity, text: str) -> None:
        """Says something as a status text."""
        ...

    def inject_failure(self, unit: int, kind: int, instance: int) -> Ack:
        """MAVLink's FAILURE_UNIT and FAILURE_TYPE; denied unless SYS_FAILURE_EN allows it."""
        ...

    def reposition(self, position_ned_m: Vector3, yaw_rad: float, speed_m_s: float) -> Ack:
        """Flies there and holds. NaN: the height or place of now, nose ahead, change_speed's."""
        ...

    def orbit(self, request: OrbitRequest) -> Ack:
        """Flies around a place from now on, or changes the orbit that is flown."""
        ...

    def change_speed(self, speed_m_s: float) -> Ack:
        """Over ground, on the way to a place; NaN goes back to MPC_XY_CRUISE."""
        ...

    def set_home(self, position_ned_m: Vector3 | None) -> Ack:
        """None for where the vehicle is now."""
        ...

    def terminate(self, reason: str) -> None:
        """Motors off at once, wherever the vehicle is."""
        ...

    def reboot(self) -> Ack:
        """Starts over with the parameters of now; time goes on."""
        ...

    def drain_status_texts(self) -> list[StatusText]:
        """The texts since the last call, oldest first."""
        ...
