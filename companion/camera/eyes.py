"""Stereo pairs in two folders, ``left`` and ``right``, with an image per eye under one name."""

from collections.abc import Iterator
from pathlib import Path

from companion.camera.asl import read_grey
from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import RecordingError
from companion.kernel.messages import StereoFrame

IMAGE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff"})
NOMINAL_PERIOD_NS = 100_000_000
"""Between pairs whose names say nothing about time."""


class EyesRecording:
    """One folder, in the order of the names; names that are all numbers are stamps [ns].

    Raises RecordingError: which file, and what is wrong.
    """

    def __init__(self, path: Path, calibration: StereoCalibration) -> None:
        self.path = path
        self.calibration = calibration
        left, right = (_images(path / eye) for eye in ("left", "right"))
        alone = sorted(set(left) ^ set(right))
        if alone:
            eye = "left" if alone[0] in left else "right"
            raise RecordingError(
                f"{path}: {len(alone)} of {len(left | right)} images have only one eye; "
                f"the first is {eye}/{(left | right)[alone[0]].name}"
            )
        self._pairs = [(stamp_ns, left[name], right[name]) for stamp_ns, name in _stamped(left)]

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[StereoFrame]:
        shape = (self.calibration.height_px, self.calibration.width_px)
        for stamp_ns, *paths in self._pairs:
            images = [read_grey(path) for path in paths]
            for path, image in zip(paths, images, strict=True):
                if image.shape != shape:
                    raise RecordingError(
                        f"{path}: image is {image.shape[1]} x {image.shape[0]}; "
                        f"the calibration declares {shape[1]} x {shape[0]}"
                    )
            left, right = images
            yield StereoFrame(stamp_ns, left, right)


def _images(folder: Path) -> dict[str, Path]:
    """Image files by their name without the suffix."""
    try:
        files = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be read: {error.strerror}") from error
    if not files:
        allowed = ", ".join(sorted(IMAGE_SUFFIXES))
        raise RecordingError(f"{folder}: holds no images; allowed: {allowed}")
    return {path.stem: path for path in files}


def _stamped(names: dict[str, Path]) -> list[tuple[int, str]]:
    if all(name.isdecimal() for name in names):
        return sorted((int(name), name) for name in names)
    return [(place * NOMINAL_PERIOD_NS, name) for place, name in enumerate(sorted(names))]
