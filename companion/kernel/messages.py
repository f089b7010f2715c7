"""What the rooms hand each other. Immutable; SI units and radians; stamps in sensor time."""

import math
from enum import StrEnum
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.kernel.frames import Quaternion, Vector3

NAN = math.nan


class StereoFrame(msgspec.Struct, frozen=True, eq=False):
    """A synchronised grey stereo pair.

    left, right: uint8 of shape (height, width), raw (not rectified); of shape (0, 0) from an eye
    that sent nothing. ``stamp_ns`` is the middle of the left eye's exposure, in nanoseconds of the
    camera's clock.
    """

    stamp_ns: int
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    skew_ns: int = 0
    """How much later the right eye was exposed."""


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


class Availability(NamedTuple):
    """What the health of the cameras lets a frame be used for."""

    stereo: bool = True
    """Both eyes are well and agree on their geometry and time."""
    left: bool = True
    right: bool = True


class Cue(StrEnum):
    """Which estimate of λ flies the vehicle."""

    STEREO = "stereo"
    MONO = "mono"
    FUSED = "fused"
    """Both, weighed by their variances."""
    NONE = "none"
    """None can be relied on: the vehicle stands still."""


class TrustStatus(StrEnum):
    """How far the learned estimate may be relied on."""

    UNTRAINED = "untrained"
    """It knows no λ yet."""
    LEARNING = "learning"
    """It knows λ, and has not shown yet that it may fly alone."""
    TRUSTED = "trusted"
    STALE = "stale"
    """It was trusted, and does not fit what is seen now."""


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
    """As its errors so far have shown it, not as the learner states it."""
    mono_novelty: float = NAN
    """How unlike all that was learned from the frame is: below 1 for most frames of the
    place that was learned, well above 1 elsewhere, or where one eye is covered."""
    motion_px: float = NAN
    """λ by the parallax of the vehicle's own motion alone; ``mono_px`` has it in it."""
    fused_px: float = NAN
    """Both cues weighed by their variances, or the one that is known."""
    fused_std_px: float = NAN


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
    trust: TrustStatus = TrustStatus.UNTRAINED
    certainty_norm: float = 1.0
    """How sure the cue that flies is that the way is clear; 1 is full speed."""


class TrustFigures(msgspec.Struct, frozen=True, kw_only=True):
    """What the status of the learned estimate was judged by; NaN where nothing defines it."""

    stamp_ns: int
    status: TrustStatus
    frames: int = 0
    """In the window, on which both cues knew λ."""
    approaches: int = 0
    """In the window, that came to an obstacle."""
    error_norm: float = NAN
    """Mean square error over the variance of stereo's λ."""
    recent_error_norm: float = NAN
    """The last seconds' error over the same variance."""
    auc: float = NAN
    collision_probability: float = NAN
    """Of an approach, with 95 % confidence no more than this."""
    novelty: float = NAN
    """Mean of the last seconds."""


class CameraFault(StrEnum):
    """What can be wrong with one eye, or with the two as a pair; the text is how logs name it."""

    NO_FRAMES = "no frames"
    FROZEN = "frozen"
    BLACK = "black"
    SATURATED = "saturated"
    HALF = "half a frame"
    TORN = "torn"
    BLURRED = "contrast lost"
    LATE = "late frames"
    SWAPPED = "left and right swapped"
    DECALIBRATED = "decalibrated"
    UNMATCHED = "eyes do not match"
    DESYNCHRONISED = "stamps out of step"


class Health(msgspec.Struct, frozen=True, kw_only=True):
    """The state of the cameras, written when it changes: what may be flown on and learned from, the
    ``CameraFault`` of each eye, of their matching and of their timing ("" for none), and the
    figures that show it.
    """

    stamp_ns: int
    stereo: bool
    left: bool
    right: bool
    left_fault: str
    right_fault: str
    pair_fault: str
    timing_fault: str
    left_evidence: str
    right_evidence: str
    pair_evidence: str
    timing_evidence: str


class Drift(msgspec.Struct, frozen=True, kw_only=True):
    """By how much the autopilot's level velocity exceeds what the stereo camera saw."""

    stamp_ns: int
    velocity_ned_m_s: tuple[float, float]
    """(north, east): the median of the last seconds."""
    scatter_m_s: float
    """Median deviation of the single measurements."""
    measurements: int
    named: bool
    """Enough to be called a drift, and to be corrected."""
    walked_ned_m: tuple[float, float]
    """How far the position has gone astray meanwhile."""


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
