"""Recorded stereo pairs, whatever file or folder holds them."""

from collections.abc import Callable, Iterable, Mapping
from os.path import exists
from pathlib import Path

from companion.camera.asl import AslRecording
from companion.camera.logged import LoggedRecording
from companion.camera.replay import Recording
from companion.kernel.errors import RecordingError

__all__ = ["OPENERS", "Recording", "open_recording", "open_recordings"]

OPENERS: Mapping[str, Callable[[Path], Recording]] = {
    "": AslRecording,
    ".mcap": LoggedRecording,
}
"""What opens a recording, by the file's suffix; folders have none."""


def open_recording(path: Path) -> Recording:
    """The recording at ``path``. Raises RecordingError."""
    if not exists(path):
        raise RecordingError(f"{path}: no such recording")
    suffix = "" if path.is_dir() else path.suffix.lower()
    if suffix not in OPENERS or (suffix == "" and not path.is_dir()):
        allowed = ", ".join(filter(None, OPENERS))
        raise RecordingError(
            f"{path}: not a recording; allowed: a folder in the EuRoC/ASL layout, {allowed}"
        )
    return OPENERS[suffix](path)


def open_recordings(paths: Iterable[Path]) -> list[Recording]:
    """Several recordings, to be taken in the order given."""
    return [open_recording(path) for path in paths]
