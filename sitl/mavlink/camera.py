"""What the vehicle tells about its camera: a stereo pair whose frames a socket publishes."""

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.calibration import StereoCalibration
from sitl.mavlink.snapshot import Message, Snapshot

DEVICE_ID = 1
"""A camera that is attached to the autopilot, and has no component of its own."""
_STREAM_ID = 1


class CameraDescription(NamedTuple):
    calibration: StereoCalibration
    rate_hz: float
    url: str
    """Where the frames are published."""

    def information(self, now: Snapshot) -> Message:
        c = self.calibration
        return mavlink.MAVLink_camera_information_message(
            now.boot_ms,
            _text("SITL", 32),
            _text(f"stereo pair, baseline {c.baseline_m * 1e3:.0f} mm", 32),
            0,
            *(math.nan,) * 3,  # focal length and sensor in mm: only the pixels are known
            c.width_px,
            c.height_px,
            0,
            mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM,
            0,
            b"",
            0,
            DEVICE_ID,
        )

    def video_stream(self, _: Snapshot) -> Message:
        """MAVLink has no type for frames as they are on a ZeroMQ socket; TCP is the nearest."""
        c = self.calibration
        half_width_rad = math.atan(c.width_px / (2.0 * c.left.focal_x_px))
        return mavlink.MAVLink_video_stream_information_message(
            _STREAM_ID,
            1,
            mavlink.VIDEO_STREAM_TYPE_TCP_MPEG,
            mavlink.VIDEO_STREAM_STATUS_FLAGS_RUNNING,
            self.rate_hz,
            c.width_px,
            c.height_px,
            round(2 * 8 * c.width_px * c.height_px * self.rate_hz),  # two eyes, 8 bits a pixel
            0,
            round(math.degrees(2.0 * half_width_rad)),
            b"stereo frames (ZeroMQ)",
            self.url.encode("ascii", "replace"),
            mavlink.VIDEO_STREAM_ENCODING_UNKNOWN,
            DEVICE_ID,
        )


def _text(text: str, width: int) -> list[int]:
    return list(text.encode("ascii")[:width].ljust(width, b"\0"))
