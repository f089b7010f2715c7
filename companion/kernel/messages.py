"""What the rooms hand each other. Immutable; SI units and radians; stamps in sensor time."""

import math
from enum import StrEnum
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.kernel.frames import Quaternion, Vector3

NAN = math.nan


class StereoFrame(msgspec.Struct, frozen=True, eq=False):
    """A synchronised grey stereo pair.

    left, right: uint8 of shape (height, width), raw (not rectified). ``stamp_ns`` is the middle of
    the exposure, in nanoseconds of the camera's clock.
    """

    stamp_ns: int
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]


class FlightMode(StrEnum):
    UNKNOWN = "unknown"
    MANUAL = "manual"
    POSITION = "position"
    ALTITUDE = "altitude"
    TAKEOFF = "takeoff"
    HOLD = "hold"
    MISSION = "mission"
    RTL = "rtl"
    LAND = "land"
    OFFBOARD = "offboard"
    ORBIT = "orbit"


class LandedState(StrEnum):
    UNKNOWN = "unknown"
    ON_GROUND = "on_ground"
    TAKING_OFF = "taking_off"
    IN_AIR = "in_air"
    LANDING = "landing"


class Telemetry(msgspec.Struct, frozen=True, kw_only=True):
    """The autopilot's newest estimate and state.

    ``stamp_ns`` is autopilot time since boot; 0 while nothing was received. Altitude is
    ``-position_ned_m[2]``, above home.
    """

    stamp_ns: int = 0
    position_ned_m: Vector3 = (NAN, NAN, NAN)
    velocity_ned_m_s: Vector3 = (NAN, NAN, NAN)
    roll_rad: float = NAN
    pitch_rad: float = NAN
    yaw_rad: float = NAN
    yaw_rate_rad_s: float = NAN
    armed: bool = False
    flight_mode: FlightMode = FlightMode.UNKNOWN
    landed_state: LandedState = LandedState.UNKNOWN
    battery_norm: float = NAN
    connected: bool = False


class Setpoint(msgspec.Struct, frozen=True, kw_only=True):
    """What the vehicle is asked to do: velocity in HFRD (level, turned by yaw) and yaw rate."""

    stamp_ns: int
    velocity_hfrd_m_s: Vector3 = (0.0, 0.0, 0.0)
    yaw_rate_rad_s: float = 0.0


class Cue(StrEnum):
    """Which of the two estimates of λ flies the vehicle."""

    STEREO = "stereo"
    MONO = "mono"


class Phase(StrEnum):
    """The experiment's phases, in order (paper section V)."""

    INITIAL = "initial"
    LEARNING = "learning"
    TEST = "test"
    DONE = "done"


class BehaviourState(StrEnum):
    """The states of the paper's finite state machine (section III-D)."""

    STRAIGHT = "straight"
    ROTATE = "rotate"
    SEARCH = "search"


class Percept(msgspec.Struct, frozen=True, kw_only=True):
    """What one frame says about λ, the average disparity in pixels; NaN where unknown."""

    stamp_ns: int
    stereo_px: float
    stereo_valid_norm: float
    """Share of pixels with a match: the quality of ``stereo_px``."""
    mono_px: float
    mono_std_px: float
    mono_novelty: float = NAN
    """How unlike all that was learned from the frame is: below 1 for most frames of the
    place that was learned, well above 1 elsewhere, or where one eye is covered."""


class MonoMap(msgspec.Struct, frozen=True, kw_only=True):
    """λ as one eye sees it in each cell of the image, NaN while unknown; row by row from the top
    left, ``columns`` to a row."""

    stamp_ns: int
    columns: int
    disparity_px: tuple[float, ...]


class Goal(msgspec.Struct, frozen=True, kw_only=True):
    """What the behaviour wants: fly ahead or turn towards a heading (NaN: turn on and on)."""

    forward_speed_m_s: float
    heading_rad: float
    turn_sign: int
    """+1 clockwise seen from above, -1 counter-clockwise, 0 the shorter way."""


class Decision(msgspec.Struct, frozen=True, kw_only=True):
    """What was decided on one percept."""

    stamp_ns: int
    phase: Phase
    cue: Cue
    override: bool
    """Stereo has taken the control from mono."""
    disparity_px: float
    """The λ that flies, NaN while unknown."""
    threshold_px: float
    """What ``disparity_px`` was compared with."""
    state: BehaviourState
    overrides: int
    """Events since the phase began."""
    turns: int
    approaches: int


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """Something worth a line in the log."""

    stamp_ns: int
    severity: str
    text: str


class MocapPose(msgspec.Struct, frozen=True, kw_only=True):
    """Truth from motion capture; nothing on board sees it, only the log and the summary."""

    stamp_ns: int
    truth_position_ned_m: Vector3
    truth_ned_from_frd: Quaternion
    truth_clearance_m: float
    """Distance from the hull to the nearest surface; negative inside one."""
    truth_collisions: int
    """Contacts with walls, floor or furniture since take-off."""


class SimulationRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What the companion asks of a simulator; ``settings`` is the plan's ``[sitl]`` table."""

    room: str
    """Path of the room's TOML file."""
    seed: int
    speed: float
    camera_rate_hz: float
    log_dir: str
    settings: dict[str, Any] = msgspec.field(default_factory=dict)
