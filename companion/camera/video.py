"""A side-by-side video file as a recording."""

from collections.abc import Iterator
from pathlib import Path

import cv2

from companion.camera.device import SideBySide
from companion.kernel.calibration import StereoCalibration
from companion.kernel.clock import SimClock
from companion.kernel.errors import CameraError, RecordingError
from companion.kernel.messages import StereoFrame


class VideoRecording:
    """Left eye in the left half; can be iterated again and again. Raises RecordingError."""

    def __init__(self, path: Path, calibration: StereoCalibration) -> None:
        self.path = path
        self.calibration = calibration
        stream = self._open()
        stream.close()
        capture = cv2.VideoCapture(str(path))
        self._length = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        capture.release()

    def __len__(self) -> int:
        """As the file's header says; a damaged video may hold fewer."""
        return self._length

    def __iter__(self) -> Iterator[StereoFrame]:
        stream = self._open()
        try:
            frame = stream.first
            while frame is not None:
                yield frame
                frame = stream.read()
        except CameraError as error:
            raise RecordingError(str(error)) from error
        finally:
            stream.close()

    def _open(self) -> SideBySide:
        try:
            # Where the file has no times, time stands still, and stamps count nanoseconds.
            return SideBySide(str(self.path), str(self.path), self.calibration, SimClock())
        except CameraError as error:
            raise RecordingError(str(error)) from error
