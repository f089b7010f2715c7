"""Recorded stereo pairs, whatever file or folder holds them."""

from collections.abc import Iterable
from os.path import exists
from pathlib import Path

from companion.camera.asl import AslRecording
from companion.camera.calibration_file import load_calibration
from companion.camera.eyes import EyesRecording
from companion.camera.logged import LoggedRecording
from companion.camera.replay import Recording
from companion.camera.video import VideoRecording
from companion.kernel.errors import RecordingError

__all__ = ["CALIBRATION_WORD", "VIDEO_SUFFIXES", "Recording", "open_recording", "open_recordings"]

VIDEO_SUFFIXES = frozenset({".avi", ".mkv", ".mov", ".mp4", ".webm"})
CALIBRATION_WORD = "?calibration="
CALIBRATION_NAME = "calibration.toml"
FORMS = (
    "a folder in the EuRoC/ASL layout, a folder with left/ and right/, "
    f".mcap, {', '.join(sorted(VIDEO_SUFFIXES))}"
)


def open_recording(path: Path) -> Recording:
    """The recording at ``path``. Raises RecordingError, PlanError for a wrong calibration file.

    Videos and left/right folders need ``?calibration=FILE`` behind their name, or a
    ``calibration.toml`` beside or in them.
    """
    name, _, calibration = str(path).partition(CALIBRATION_WORD)
    path = Path(name)
    if not exists(path):
        raise RecordingError(f"{path}: no such recording")
    if path.is_dir():
        if not ((path / "left").is_dir() and (path / "right").is_dir()):
            return AslRecording(path)
        return EyesRecording(path, load_calibration(_calibration_of(path, path, calibration)))
    suffix = path.suffix.lower()
    if suffix == ".mcap":
        return LoggedRecording(path)
    if suffix in VIDEO_SUFFIXES:
        found = _calibration_of(path, path.parent, calibration)
        return VideoRecording(path, load_calibration(found))
    raise RecordingError(f"{path}: not a recording; allowed: {FORMS}")


def _calibration_of(recording: Path, folder: Path, named: str) -> Path:
    path = Path(named) if named else folder / CALIBRATION_NAME
    if not path.is_file():
        raise RecordingError(
            f"{recording}: needs its camera's geometry: {path} does not exist; "
            f"write it, or append {CALIBRATION_WORD}FILE.toml"
        )
    return path


def open_recordings(paths: Iterable[Path]) -> list[Recording]:
    """Several recordings, to be taken in the order given."""
    return [open_recording(path) for path in paths]
