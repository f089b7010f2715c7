"""What ``--camera`` may say, and the cameras that it opens."""

from collections.abc import Collection
from os.path import exists
from pathlib import Path
from typing import NamedTuple

from companion.camera.calibration_file import load_calibration
from companion.camera.device import DeviceStereoCamera, VideoStereoCamera
from companion.camera.recording import CALIBRATION_WORD, VIDEO_SUFFIXES, open_recording
from companion.camera.remote import RemoteCamera
from companion.camera.replay import ReplayCamera
from companion.kernel.calibration import StereoCalibration
from companion.kernel.clock import Clock
from companion.kernel.errors import PlanError
from companion.kernel.protocols import StereoCamera

REMOTE_SCHEMES = ("tcp://", "ipc://")
_DEVICE = "device:"
_FORMS = (
    "tcp://HOST:PORT, device:N?calibration=FILE, VIDEO?calibration=FILE, "
    "a recording's folder or a flight log (.mcap)"
)


class SimulatedSpec(NamedTuple):
    """The camera of a simulator, by the simulator's name."""

    simulator: str


class RemoteSpec(NamedTuple):
    """Frames from another process."""

    url: str


class DeviceSpec(NamedTuple):
    """A live side-by-side stream: an index, a device file or a GStreamer pipeline."""

    source: int | str
    calibration: StereoCalibration


class VideoSpec(NamedTuple):
    """A side-by-side video file."""

    path: Path
    calibration: StereoCalibration


class RecordedSpec(NamedTuple):
    """A folder or file, with the word for its calibration where it does not hold its own."""

    path: Path


CameraSpec = SimulatedSpec | RemoteSpec | DeviceSpec | VideoSpec | RecordedSpec


def parse_camera(spec: str, simulators: Collection[str] = ("sitl",)) -> CameraSpec:
    """The camera that ``spec`` names. Raises PlanError: what is wrong and what is allowed."""
    if spec in simulators:
        return SimulatedSpec(spec)
    if spec.startswith(REMOTE_SCHEMES):
        return RemoteSpec(spec)
    source, _, calibration = spec.partition(CALIBRATION_WORD)
    if source.startswith(_DEVICE):
        name = source.removeprefix(_DEVICE)
        return DeviceSpec(int(name) if name.isdecimal() else name, _calibration(spec, calibration))
    path = Path(source)
    if not exists(path):  # also False for a name that no file system takes
        raise PlanError(
            f"--camera {spec}: no such file; allowed: {', '.join(simulators)}, {_FORMS}"
        )
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return VideoSpec(path, _calibration(spec, calibration))
    return RecordedSpec(Path(spec))


def open_camera(spec: str, clock: Clock) -> StereoCamera:
    """The camera that ``spec`` names, to be entered. Raises PlanError or RecordingError."""
    match parse_camera(spec, simulators=()):
        case RemoteSpec(url):
            return RemoteCamera(url)
        case DeviceSpec(source, calibration):
            return DeviceStereoCamera(source, calibration, clock)
        case VideoSpec(path, calibration):
            return VideoStereoCamera(path, calibration, clock)
        case RecordedSpec(path):
            return ReplayCamera(open_recording(path))
        case SimulatedSpec(simulator):
            raise PlanError(f"--camera {simulator}: only together with --vehicle {simulator}")


def _calibration(spec: str, path: str) -> StereoCalibration:
    if not path:
        raise PlanError(f"--camera {spec}: needs its geometry; append {CALIBRATION_WORD}FILE.toml")
    return load_calibration(Path(path))
