"""What the vehicle tells about its camera: a stereo pair whose frames a socket publishes."""

import math
from collections.abc import Callable
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
        return mavlink.MAVLink_video_stream_information_message(
            _STREAM_ID,
            1,
            mavlink.VIDEO_STREAM_TYPE_TCP_MPEG,
            *self._stream,
            b"stereo frames (ZeroMQ)",
            self.url.encode("ascii", "replace"),
            mavlink.VIDEO_STREAM_ENCODING_UNKNOWN,
            DEVICE_ID,
        )

    def video_status(self, _: Snapshot) -> Message:
        return mavlink.MAVLink_video_stream_status_message(_STREAM_ID, *self._stream, DEVICE_ID)

    def settings(self, now: Snapshot) -> Message:
        """It makes a video, always, and does not zoom or focus."""
        return mavlink.MAVLink_camera_settings_message(
            now.boot_ms, mavlink.CAMERA_MODE_VIDEO, math.nan, math.nan, DEVICE_ID
        )

    @property
    def builders(self) -> dict[int, Callable[[Snapshot], Message]]:
        """By message id."""
        return {
            mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION: self.information,
            mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS: self.settings,
            mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION: self.video_stream,
            mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS: self.video_status,
        }

    @property
    def _stream(self) -> tuple[int, float, int, int, int, int, int]:
        """Flags, rate, width, height, bits per second of two eyes, rotation, field of view."""
        width_px, height_px = self.calibration.width_px, self.calibration.height_px
        hfov_rad = 2.0 * math.atan(width_px / (2.0 * self.calibration.left.focal_x_px))
        return (
            mavlink.VIDEO_STREAM_STATUS_FLAGS_RUNNING,
            self.rate_hz,
            width_px,
            height_px,
            round(2 * 8 * width_px * height_px * self.rate_hz),
            0,
            round(math.degrees(hfov_rad)),
        )


def _text(text: str, width: int) -> list[int]:
    return list(text.encode("ascii")[:width].ljust(width, b"\0"))
