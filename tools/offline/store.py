"""What recordings hold, worked out once: images, λ of our stereo and features, as files of arrays.

A cache may be deleted at any time; it is made again where it is missing.
"""

import hashlib
import os
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.camera.recording import CALIBRATION_WORD, VIDEO_SUFFIXES, open_recording
from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import PlanError, RecordingError
from companion.logfolder import LOG_NAME
from companion.vision.stereo import StereoMatcher, StereoSettings

IMAGES, CALIBRATION = "images.npy", "calibration.json"
CODE = (
    "companion/*.py",
    "companion/regressors/*.py",
    *(f"tools/offline/{name}.py" for name in ("features", "splits", "trial")),
)
"""What figures depend on beside settings: another version of it must not use what this one kept."""


def find_recordings(paths: Iterable[Path]) -> list[Path]:
    """Recordings, and those in folders that are none themselves. Raises RecordingError."""
    found: list[Path] = []
    for path in paths:
        inside = sorted(filter(_is_recording, path.iterdir())) if path.is_dir() else []
        found += inside if inside and not _is_recording(path) else [path]
    names = [name_of(path) for path in found]
    for name in names:
        if names.count(name) > 1:
            raise PlanError(f"two recordings are called {name!r}; give folders of other names")
    return found


def _is_recording(path: Path) -> bool:
    if path.is_dir():
        return any((path / name).exists() for name in ("mav0", "cam0", "left", LOG_NAME))
    return path.suffix.lower() in {".mcap", *VIDEO_SUFFIXES}


def name_of(path: Path) -> str:
    """A log is called after its folder, all else after itself."""
    path = Path(str(path).partition(CALIBRATION_WORD)[0])
    return path.parent.name if path.name == LOG_NAME else path.stem


def digest(*parts: object) -> str:
    """A short name for these settings or bytes: the same for the same."""
    told = hashlib.blake2s(digest_size=8)
    for part in parts:
        encoded = part if isinstance(part, bytes) else msgspec.json.encode(part)
        told.update(len(encoded).to_bytes(8) + encoded)
    return told.hexdigest()


@cache
def code_key() -> str:
    """A short name for this version of the code."""
    root = Path(__file__).parents[2]
    return digest(*(path.read_bytes() for kind in CODE for path in sorted(root.glob(kind))))


class Stored:
    """One recording in the cache. It can be handed to other processes."""

    def __init__(self, path: Path, cache_folder: Path) -> None:
        self.path = path / LOG_NAME if (path / LOG_NAME).is_file() else path
        self.name = name_of(path)
        self.key = digest(*_stamps(self.path))
        self.folder = cache_folder / "recordings" / self.key
        self.derived = self.folder / code_key()
        """Files that also depend on the code."""

    @property
    def calibration(self) -> StereoCalibration:
        text = (self.folder / CALIBRATION).read_bytes()
        return msgspec.json.decode(text, type=StereoCalibration)

    @property
    def images(self) -> NDArray[np.uint8]:
        """(n, 2, height, width), left eye first; read from the disk as it is looked at."""
        images: NDArray[np.uint8] = np.load(self.folder / IMAGES, mmap_mode="r")
        return images

    def __len__(self) -> int:
        return len(self.images)

    def labels(self, stereo: StereoSettings) -> NDArray[np.float64]:
        """(n, 2): λ as the mean and as the quantile, NaN where unknown."""
        return np.asarray(np.load(self._labels_path(stereo)))

    def prepare(self, stereo: StereoSettings) -> None:
        """Makes what is missing of images and labels. Raises RecordingError, CameraError."""
        if not (self.folder / CALIBRATION).is_file():
            self._store_images()
        path = self._labels_path(stereo)
        if not path.is_file():
            matcher = StereoMatcher(stereo, self.calibration)
            results = (matcher.match(left, right) for left, right in self.images)
            save_array(path, np.array([(one.mean_px, one.quantile_px) for one in results]))

    def _labels_path(self, stereo: StereoSettings) -> Path:
        return self.derived / f"labels-{digest(stereo)}.npy"

    def _store_images(self) -> None:
        recording = open_recording(self.path)
        pairs = [np.stack([frame.left, frame.right]) for frame in recording]
        if not pairs:
            raise RecordingError(f"{self.path}: holds no pairs")
        save_array(self.folder / IMAGES, np.stack(pairs))
        text = msgspec.json.encode(recording.calibration)
        write_whole(self.folder / CALIBRATION, text)


def _stamps(path: Path) -> list[Any]:
    """What changes when a recording does: names, sizes and dates of its files."""
    path = Path(str(path).partition(CALIBRATION_WORD)[0])
    stamps: list[Any] = [str(path.resolve())]
    files = [path] if path.is_file() else (Path(d, f) for d, _, fs in os.walk(path) for f in fs)
    for file in sorted(files):
        facts = file.stat()
        stamps.append((str(file.relative_to(path)), facts.st_size, facts.st_mtime_ns))
    if len(stamps) == 1:
        raise RecordingError(f"{path}: no such recording")
    return stamps


def save_array(path: Path, values: NDArray[np.generic]) -> None:
    """All of it or nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.npy")
    np.save(part, values)
    part.replace(path)


def write_whole(path: Path, content: bytes) -> None:
    """All of it or nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    part.write_bytes(content)
    part.replace(path)
