"""What a client outside has measured of the vehicle's motion; no MAVLink in here."""

from typing import NamedTuple

from companion.kernel.frames import Quaternion, Vector3
from companion.kernel.messages import NAN

_UNKNOWN3: Vector3 = (NAN, NAN, NAN)


class VisionSample(NamedTuple):
    """One pose, a velocity, or both; NaN, or None, for what was not measured."""

    stamp_s: float
    """On the client's clock, which may be the vehicle's; NaN if it did not say."""
    position_m: Vector3 = _UNKNOWN3
    """In a frame with z down: NED if ``north_known``, else turned by an angle nobody knows."""
    attitude: Quaternion | None = None
    """From forward, right, down into that frame."""
    velocity_m_s: Vector3 = _UNKNOWN3
    """In that frame, or along forward, right, down if ``velocity_in_body``."""
    velocity_in_body: bool = False
    north_known: bool = True
    position_variance_m2: Vector3 = _UNKNOWN3
    yaw_variance_rad2: float = NAN
    velocity_variance_m2_s2: Vector3 = _UNKNOWN3
    reset_counter: int = 0
    """Changes when the client's frame has jumped."""
    quality_percent: int = 0
    """0 if unknown, negative if the client knows it to be wrong."""


class Measured(NamedTuple):
    """A sample that may be used, on the vehicle's clock and in NED; NaN for what is unknown."""

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    yaw_rad: float
    sample: VisionSample
