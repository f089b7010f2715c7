"""A recording in the place of a camera."""

from collections.abc import AsyncGenerator, Iterator
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import CameraError
from companion.kernel.messages import StereoFrame, Telemetry


class Recording(Protocol):
    """Stereo pairs at rest, oldest first."""

    @property
    def calibration(self) -> StereoCalibration: ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[StereoFrame]: ...


@runtime_checkable
class TellsMotion(Protocol):
    """A recording that also holds what the autopilot told."""

    def telemetry_at(self, stamp_ns: int) -> Telemetry:
        """With the pair of that stamp; an empty one where there is none."""
        ...


class ReplayCamera:
    """Every pair in its turn, as fast as they are taken; none is dropped."""

    frames_dropped = 0

    def __init__(self, recording: Recording) -> None:
        self.calibration = recording.calibration
        self._recording = recording

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """A recording holds nothing open between two frames."""

    async def frames(self) -> AsyncGenerator[StereoFrame, None]:
        """Ends with the recording. Raises CameraError for a pair of another geometry."""
        shape = (self.calibration.height_px, self.calibration.width_px)
        for frame in self._recording:
            if frame.left.shape != shape or frame.right.shape != shape:
                raise CameraError(
                    f"recording: pair at {frame.stamp_ns} ns is {frame.left.shape} and "
                    f"{frame.right.shape} (height, width); its calibration says {shape}"
                )
            yield frame
