"""Stereo pairs in the EuRoC/ASL folder layout.

``mav0/cam0`` is the left eye, ``mav0/cam1`` the right one; each holds ``sensor.yaml``, ``data.csv``
(stamp in nanoseconds, file name) and the images in ``data/``.
"""

import csv
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import RecordingError
from companion.kernel.messages import StereoFrame

OFF_AXIS_LIMIT_NORM = 0.05
"""How far the right eye may lie off the rows of the left one, as a share of the baseline."""

UNDISTORTED = frozenset({"none", "null"})
RADIAL_TANGENTIAL = frozenset({"radial-tangential", "radtan", "plumb_bob"})

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


class AslRecording:
    """One folder, oldest pair first. Raises RecordingError: which file, and what is wrong."""

    def __init__(self, path: Path) -> None:
        self.path = path
        root = path / "mav0" if (path / "mav0").is_dir() else path
        eyes = root / "cam0", root / "cam1"
        self.calibration = _calibration(eyes[0] / "sensor.yaml", eyes[1] / "sensor.yaml")
        left, right = (_index(eye) for eye in eyes)
        _check_stamps(root, set(left), set(right))
        self._pairs = [(stamp_ns, left[stamp_ns], right[stamp_ns]) for stamp_ns in sorted(left)]

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[StereoFrame]:
        for stamp_ns, left, right in self._pairs:
            yield StereoFrame(stamp_ns, self._grey(left), self._grey(right))

    def _grey(self, path: Path) -> NDArray[np.uint8]:
        image = read_grey(path)
        declared = (self.calibration.height_px, self.calibration.width_px)
        if image.shape != declared:
            raise RecordingError(
                f"{path}: image is {image.shape[1]} x {image.shape[0]}; "
                f"sensor.yaml declares {declared[1]} x {declared[0]}"
            )
        return image


def read_grey(path: Path) -> NDArray[np.uint8]:
    """An image file as grey levels (height, width). Raises RecordingError naming the file."""
    try:
        encoded = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    if encoded.startswith(_PNG_SIGNATURE) and not _is_whole_png(encoded):
        raise RecordingError(f"{path}: PNG is truncated or damaged")
    image = (
        cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_GRAYSCALE) if encoded else None
    )
    if image is None:
        raise RecordingError(f"{path}: not an image")
    return np.asarray(image, dtype=np.uint8)


def _is_whole_png(encoded: bytes) -> bool:
    """True if every chunk is there with the right checksum: decoders fill gaps in silence."""
    place = len(_PNG_SIGNATURE)
    while place + 12 <= len(encoded):
        length = int.from_bytes(encoded[place : place + 4], "big")
        end = place + 8 + length
        checksum = int.from_bytes(encoded[end : end + 4], "big")
        if end + 4 > len(encoded) or zlib.crc32(encoded[place + 4 : end]) != checksum:
            return False
        if encoded[place + 4 : place + 8] == b"IEND":
            return True
        place = end + 4
    return False


def _index(eye: Path) -> dict[int, Path]:
    """Image files by stamp [ns]."""
    path = eye / "data.csv"
    index: dict[int, Path] = {}
    try:
        with path.open(newline="") as file:
            for row in csv.reader(file):
                if row and not row[0].startswith("#"):
                    index[int(row[0])] = eye / "data" / row[1].strip()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    except (ValueError, IndexError, csv.Error) as error:
        raise RecordingError(f"{path}: rows must be STAMP_NS,FILE: {error}") from error
    if not index:
        raise RecordingError(f"{path}: lists no images")
    return index


def _check_stamps(root: Path, left: set[int], right: set[int]) -> None:
    unmatched = sorted(left ^ right)
    if unmatched:
        alone = "cam0" if unmatched[0] in left else "cam1"
        raise RecordingError(
            f"{root}: {len(unmatched)} of {len(left | right)} stamps have only one eye; "
            f"the first is {unmatched[0]} in {alone}/data.csv"
        )


def _calibration(left_path: Path, right_path: Path) -> StereoCalibration:
    """Both eyes' sensor.yaml as one calibration."""
    left_size, left, body_from_left = _eye(left_path)
    right_size, right, body_from_right = _eye(right_path)
    if left_size != right_size:
        raise RecordingError(
            f"{right_path}: resolution is {right_size}; that of cam0 is {left_size}"
        )
    right_from_left = np.linalg.inv(body_from_right) @ body_from_left
    baseline_m, *off_axis_m = -right_from_left[:3, 3]
    if baseline_m <= 0.0 or max(map(abs, off_axis_m)) > OFF_AXIS_LIMIT_NORM * baseline_m:
        raise RecordingError(
            f"{right_path}: T_BS: right eye is {baseline_m:.3g} m right, {off_axis_m[0]:.3g} m "
            f"below and {off_axis_m[1]:.3g} m before the left one; must be to its right, within "
            f"{OFF_AXIS_LIMIT_NORM:.0%}"
        )
    rotation = tuple(float(value) for value in right_from_left[:3, :3].flat)
    return StereoCalibration(
        *left_size,
        left=left,
        right=right,
        baseline_m=float(baseline_m),
        right_from_left=rotation,  # type: ignore[arg-type]  # nine values by its slice
    )


def _eye(path: Path) -> tuple[tuple[int, int], Intrinsics, NDArray[np.float64]]:
    """((width, height), intrinsics, body_from_camera (4, 4)) of one sensor.yaml."""
    sensor = read_sensor_yaml(path)
    if sensor.get("camera_model", "pinhole") != "pinhole":
        raise RecordingError(f"{path}: camera_model: {sensor['camera_model']}; allowed: pinhole")
    width_px, height_px = (int(value) for value in _numbers(sensor, "resolution", 2, path))
    if width_px <= 0 or height_px <= 0:
        raise RecordingError(f"{path}: resolution: must be above 0")
    focal_x, focal_y, centre_x, centre_y = _numbers(sensor, "intrinsics", 4, path)
    if focal_x <= 0.0 or focal_y <= 0.0:
        raise RecordingError(f"{path}: intrinsics: focal lengths must be above 0")
    eye = Intrinsics(focal_x, focal_y, centre_x, centre_y, _distortion(sensor, path))
    pose = np.array(_numbers(sensor, "T_BS.data", 16, path)).reshape(4, 4)
    turn = pose[:3, :3]
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3):
        raise RecordingError(f"{path}: T_BS: not a rotation and a translation")
    return (width_px, height_px), eye, pose


def _distortion(sensor: dict[str, Any], path: Path) -> tuple[float, float, float, float]:
    model = sensor.get("distortion_model", "none")
    if model in UNDISTORTED:
        return 0.0, 0.0, 0.0, 0.0
    if model not in RADIAL_TANGENTIAL:
        allowed = ", ".join(sorted(RADIAL_TANGENTIAL | UNDISTORTED))
        raise RecordingError(f"{path}: distortion_model: {model}; allowed: {allowed}")
    k1, k2, p1, p2 = _numbers(sensor, "distortion_coefficients", 4, path)
    return k1, k2, p1, p2


def _numbers(sensor: dict[str, Any], key: str, count: int, path: Path) -> list[float]:
    values = sensor.get(key)
    if values is None:
        raise RecordingError(f"{path}: {key}: missing")
    try:
        numbers = [float(value) for value in values]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise RecordingError(f"{path}: {key}: must be {count} numbers")
    return numbers


def read_sensor_yaml(path: Path) -> dict[str, Any]:
    """Keys of the simple YAML of this layout, nested ones as ``outer.inner``.

    Understands ``key: value`` with a word, a number or a bracketed list, which may run over lines;
    one level of indented keys; comments. That is all that these files hold.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RecordingError(f"{path}: missing: a recording needs its calibration") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    values: dict[str, Any] = {}
    outer = ""
    for line in _logical_lines(text):
        key, colon, value = line.partition(":")
        if not colon:
            raise RecordingError(f"{path}: not KEY: VALUE: {line.strip()!r}")
        indented = key[:1].isspace()
        name = f"{outer}.{key.strip()}" if indented else key.strip()
        if not indented:
            outer = name
        if value.strip():
            values[name] = _value(value.strip())
    return values


def _logical_lines(text: str) -> Iterator[str]:
    """Lines without comments, a bracketed list on one of them."""
    pending = ""
    for line in text.splitlines():
        bare = line.split("#", 1)[0].rstrip()
        if not bare or (not pending and bare.startswith(("%", "---"))):
            continue
        pending = f"{pending} {bare.strip()}" if pending else bare
        if pending.count("[") <= pending.count("]"):
            yield pending
            pending = ""
    if pending:
        yield pending


def _value(text: str) -> object:
    """A word, a number or a list of numbers."""
    try:
        if text.startswith("["):
            return [float(part) for part in text.strip("[] ").rstrip(",").split(",")]
        return float(text)
    except ValueError:
        return text.strip("\"'")
