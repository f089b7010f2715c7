"""A flight log with images as a recording."""

from collections.abc import Iterator
from pathlib import Path

from companion.flightlog import FlightLog, Topic
from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import RecordingError
from companion.kernel.messages import StereoFrame


class LoggedRecording:
    """The stereo pairs of one log, oldest first; can be iterated again and again.

    Raises RecordingError for a log without images or without a calibration.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._log = FlightLog(path)
        self._length = self._log.topics().get(Topic.RIGHT, 0)
        if not self._length:
            raise RecordingError(
                f'{path}: logged no images; fly with `images = "stereo"` in the plan\'s [log] table'
            )
        if self._log.metadata.calibration is None:
            raise RecordingError(f"{path}: says nothing about its camera's calibration")
        self.calibration: StereoCalibration = self._log.metadata.calibration

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[StereoFrame]:
        return self._log.frames()
