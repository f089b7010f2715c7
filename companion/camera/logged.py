"""A flight log with images as a recording."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

from companion.flightlog import FlightLog, Topic
from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import RecordingError
from companion.kernel.messages import StereoFrame, Telemetry

NOTHING_TOLD = Telemetry()


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

    def telemetry_at(self, stamp_ns: int) -> Telemetry:
        """What was flown on beside the pair of that stamp; an empty one where there is none."""
        return self._told.get(stamp_ns, NOTHING_TOLD)

    @cached_property
    def _told(self) -> dict[int, Telemetry]:
        """By the stamps of the pairs: its own is the autopilot's clock."""
        if Topic.TELEMETRY not in self._log.topics():
            return {}
        stamps_ns = self._log.log_times_ns(Topic.TELEMETRY).tolist()
        return dict(zip(stamps_ns, self._log.read(Topic.TELEMETRY, Telemetry), strict=True))
