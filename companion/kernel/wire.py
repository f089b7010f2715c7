"""What goes over the camera's socket: multipart messages of a topic, a header and raw images.

=========  =====================================  ================================
topic      header (msgpack)                       further parts
=========  =====================================  ================================
``frame``  ``FrameHeader``                        left, right: height x width bytes, or none
``truth``  ``TruthHeader``                        none
=========  =====================================  ================================

Each frame carries the calibration, so that a client may come late and needs no second message.
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import CameraError
from companion.kernel.messages import MocapPose, StereoFrame

WIRE_VERSION = 1
FRAME_TOPIC = b"frame"
TRUTH_TOPIC = b"truth"

MAX_IMAGE_BYTES = 16 * 1024 * 1024
MAX_HEADER_BYTES = 1024 * 1024


class FrameHeader(msgspec.Struct, frozen=True, kw_only=True):
    """``sequence`` counts the frames sent, so that a client can count those it did not get."""

    version: int = WIRE_VERSION
    sequence: int
    stamp_ns: int
    width_px: int
    height_px: int
    calibration: StereoCalibration
    skew_ns: int = 0


class TruthHeader(msgspec.Struct, frozen=True, kw_only=True):
    version: int = WIRE_VERSION
    poses: list[MocapPose]


class SentFrame(NamedTuple):
    frame: StereoFrame
    sequence: int
    calibration: StereoCalibration


_Header = TypeVar("_Header", FrameHeader, TruthHeader)

_encoder = msgspec.msgpack.Encoder()
_frame_decoder = msgspec.msgpack.Decoder(FrameHeader)
_truth_decoder = msgspec.msgpack.Decoder(TruthHeader)


def encode_frame(frame: StereoFrame, sequence: int, calibration: StereoCalibration) -> list[bytes]:
    declared = calibration.height_px, calibration.width_px
    sent = [eye.shape for eye in (frame.left, frame.right) if eye.size]
    height_px, width_px = sent[0] if sent else declared
    header = FrameHeader(
        sequence=sequence,
        stamp_ns=frame.stamp_ns,
        width_px=width_px,
        height_px=height_px,
        calibration=calibration,
        skew_ns=frame.skew_ns,
    )
    return [FRAME_TOPIC, _encoder.encode(header), frame.left.tobytes(), frame.right.tobytes()]


def encode_truth(poses: Sequence[MocapPose]) -> list[bytes]:
    return [TRUTH_TOPIC, _encoder.encode(TruthHeader(poses=list(poses)))]


def decode_frame(parts: Sequence[bytes]) -> SentFrame:
    """Raises CameraError naming what was expected and what came. The images are writable copies."""
    _expect("parts of a frame", 4, len(parts))
    header = _decoded(_frame_decoder, parts[1])
    for name, got, expected in (
        ("width_px", header.width_px, header.calibration.width_px),
        ("height_px", header.height_px, header.calibration.height_px),
    ):
        _expect(f"{name} as calibrated", expected, got)
    frame = StereoFrame(
        stamp_ns=header.stamp_ns,
        left=_image("left", parts[2], header),
        right=_image("right", parts[3], header),
        skew_ns=header.skew_ns,
    )
    return SentFrame(frame, header.sequence, header.calibration)


def decode_truth(parts: Sequence[bytes]) -> list[MocapPose]:
    """Raises CameraError as ``decode_frame`` does."""
    _expect("parts of a truth message", 2, len(parts))
    return _decoded(_truth_decoder, parts[1]).poses


def _decoded(decoder: msgspec.msgpack.Decoder[_Header], part: bytes) -> _Header:
    if len(part) > MAX_HEADER_BYTES:
        raise CameraError(
            f"camera message: header of {len(part)} bytes; at most {MAX_HEADER_BYTES} are allowed"
        )
    try:
        version = msgspec.msgpack.decode(part, type=_Version).version
        _expect("version", WIRE_VERSION, version)
        return decoder.decode(part)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise CameraError(f"camera message: damaged header: {error}") from error


class _Version(msgspec.Struct):
    """Read before the rest, which another version may spell differently."""

    version: int


def _image(eye: str, part: bytes, header: FrameHeader) -> NDArray[np.uint8]:
    expected_bytes = header.width_px * header.height_px
    if not 0 < expected_bytes <= MAX_IMAGE_BYTES:
        raise CameraError(
            f"camera message: image of {header.width_px}x{header.height_px} px; "
            f"at most {MAX_IMAGE_BYTES} pixels are allowed"
        )
    if not part:
        return np.empty((0, 0), np.uint8)
    _expect(f"bytes of the {eye} image", expected_bytes, len(part))
    pixels = np.frombuffer(part, dtype=np.uint8)
    return pixels.reshape(header.height_px, header.width_px).copy()


def _expect(what: str, expected: int, got: int) -> None:
    if got != expected:
        raise CameraError(f"camera message: {what}: expected {expected}, got {got}")
