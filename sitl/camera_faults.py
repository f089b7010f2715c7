"""What can go wrong between the lens and the companion, done to pairs that were sound."""

from collections import deque
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.messages import StereoFrame

Grey = NDArray[np.uint8]

EyeFault = Literal[
    "none", "no_frames", "frozen", "black", "saturated", "half", "torn", "defocused", "dirty"
]
PairFault = Literal[
    "none", "no_frames", "frozen", "late", "swapped", "decalibrated", "desynchronised"
]

LATE_S: Final = 0.3
BLACK_LSB: Final = 3
WHITE_LSB: Final = 252
HALF_NORM: Final = 0.6
"""Share of the rows that still arrive."""
DEFOCUS_PX: Final = 3.0
"""Deviation of the blur; that of dirt, too near to be sharp, comes with a veil."""
DIRT_PX, DIRT_CONTRAST, VEIL_LSB = 2.0, 0.25, 110.0
NOISE_LSB: Final = 1.5
KNOCK_ROWS_PX, KNOCK_ROLL_DEG = 3.0, 1.0
"""Of an eye that was knocked: lower, and turned about the optical axis."""
LEAST_TEAR_PX: Final = 12
NOTHING: Final[Grey] = np.empty((0, 0), np.uint8)


class CameraFaults:
    """The faults that are present; ``deliver`` is what comes of each pair."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.left_eye: EyeFault = "none"
        self.right_eye: EyeFault = "none"
        self.pair: PairFault = "none"
        self._rng = rng
        self._delivered: StereoFrame | None = None
        self._taken: StereoFrame | None = None
        self._waiting: deque[StereoFrame] = deque()

    def deliver(self, frame: StereoFrame) -> StereoFrame | None:
        """The pair that the companion gets at this exposure, if any."""
        paired = self._pair(frame)
        self._taken = frame
        if paired is None:
            return None
        before = self._delivered or paired
        self._delivered = StereoFrame(
            paired.stamp_ns,
            self._eye(self.left_eye, paired.left, before.left),
            self._eye(self.right_eye, paired.right, before.right),
            paired.skew_ns,
        )
        return self._delivered

    def _pair(self, frame: StereoFrame) -> StereoFrame | None:
        stamp_ns, before = frame.stamp_ns, self._taken or frame
        if self.pair == "late":
            return self._late(frame)
        self._waiting.clear()
        match self.pair:
            case "no_frames":
                return None
            case "frozen":
                stuck = self._delivered or frame
                return StereoFrame(stamp_ns, stuck.left, stuck.right)
            case "swapped":
                return StereoFrame(stamp_ns, frame.right, frame.left)
            case "decalibrated":
                return StereoFrame(stamp_ns, frame.left, _knocked(frame.right))
            case "desynchronised":
                skew_ns = before.stamp_ns - stamp_ns
                return StereoFrame(stamp_ns, frame.left, before.right, skew_ns)
        return frame

    def _late(self, frame: StereoFrame) -> StereoFrame | None:
        """The newest of those that have waited for long enough."""
        self._waiting.append(frame)
        if (frame.stamp_ns - self._waiting[0].stamp_ns) * 1e-9 < LATE_S - 1e-6:
            return None
        return self._waiting.popleft()

    def _eye(self, fault: EyeFault, image: Grey, before: Grey) -> Grey:
        match fault:
            case "no_frames":
                return NOTHING
            case "frozen":
                return before if before.size else image
            case "black":
                return np.minimum(image, BLACK_LSB)
            case "saturated":
                return np.maximum(image, WHITE_LSB)
            case "half":
                return _half(image)
            case "torn":
                return self._torn(image)
            case "defocused":
                return self._noisy(_blurred(image, DEFOCUS_PX))
            case "dirty":
                return self._noisy(DIRT_CONTRAST * _blurred(image, DIRT_PX) + VEIL_LSB)
        return image

    def _noisy(self, image: NDArray[np.float32]) -> Grey:
        """Noise comes after the lens, so that no blur takes it away."""
        noise = self._rng.standard_normal(image.shape, np.float32) * NOISE_LSB
        return np.clip(image + noise, 0.0, 255.0).astype(np.uint8)

    def _torn(self, image: Grey) -> Grey:
        """From some row on the line's start is lost."""
        height, width = image.shape
        row = int(self._rng.integers(height // 4, 3 * height // 4))
        shift = int(self._rng.integers(LEAST_TEAR_PX, width - LEAST_TEAR_PX))
        return np.vstack([image[:row], np.roll(image[row:], shift, axis=1)])


def _half(image: Grey) -> Grey:
    arrived = image.copy()
    arrived[round(HALF_NORM * len(image)) :] = 0
    return arrived


def _blurred(image: Grey, deviation_px: float) -> NDArray[np.float32]:
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), deviation_px)
    return np.asarray(blurred, dtype=np.float32)


def _knocked(image: Grey) -> Grey:
    height, width = image.shape
    centre = ((width - 1) / 2, (height - 1) / 2)
    turn = cv2.getRotationMatrix2D(centre, KNOCK_ROLL_DEG, 1.0)
    turn[1, 2] += KNOCK_ROWS_PX
    warped = cv2.warpAffine(image, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, dtype=np.uint8)
