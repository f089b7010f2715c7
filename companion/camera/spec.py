"""What ``--camera`` may say."""

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import PlanError
from companion.kernel.settings import convert_settings, read_toml

VIDEO_SUFFIXES = frozenset({".avi", ".mkv", ".mov", ".mp4", ".webm"})
REMOTE_SCHEMES = ("tcp://", "ipc://")
_DEVICE = "device:"
_CALIBRATION = "?calibration="
_FORMS = (
    "tcp://HOST:PORT, device:N?calibration=FILE, VIDEO?calibration=FILE, "
    "a recording's folder or a flight log (.mcap)"
)


class SimulatedCamera(NamedTuple):
    """The camera of a simulator, by the simulator's name."""

    simulator: str


class RemoteCamera(NamedTuple):
    """Frames from another process."""

    url: str


class DeviceCamera(NamedTuple):
    """A live side-by-side stream: an index, a device file or a GStreamer pipeline."""

    source: int | str
    calibration: StereoCalibration


class VideoCamera(NamedTuple):
    """A side-by-side video file."""

    path: Path
    calibration: StereoCalibration


class RecordedCamera(NamedTuple):
    """A folder or file that holds its own calibration."""

    path: Path


CameraSpec = SimulatedCamera | RemoteCamera | DeviceCamera | VideoCamera | RecordedCamera


def parse_camera(spec: str, simulators: Collection[str] = ("sitl",)) -> CameraSpec:
    """The camera that ``spec`` names. Raises PlanError: what is wrong and what is allowed."""
    if spec in simulators:
        return SimulatedCamera(spec)
    if spec.startswith(REMOTE_SCHEMES):
        return RemoteCamera(spec)
    source, _, calibration = spec.partition(_CALIBRATION)
    if source.startswith(_DEVICE):
        name = source.removeprefix(_DEVICE)
        return DeviceCamera(
            int(name) if name.isdecimal() else name, _calibration(spec, calibration)
        )
    path = Path(source)
    if not path.exists():
        raise PlanError(
            f"--camera {spec}: no such file; allowed: {', '.join(simulators)}, {_FORMS}"
        )
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return VideoCamera(path, _calibration(spec, calibration))
    return RecordedCamera(path)


def load_calibration(path: Path) -> StereoCalibration:
    """A StereoCalibration written as TOML. Raises PlanError: file, key and what is allowed."""
    calibration = convert_settings(read_toml(path), StereoCalibration, str(path))
    for name in ("width_px", "height_px", "baseline_m"):
        if getattr(calibration, name) <= 0:
            raise PlanError(f"{path}: {name}: {getattr(calibration, name)}, must be above 0")
    return calibration


def _calibration(spec: str, path: str) -> StereoCalibration:
    if not path:
        raise PlanError(f"--camera {spec}: needs its geometry; append {_CALIBRATION}FILE.toml")
    return load_calibration(Path(path))
