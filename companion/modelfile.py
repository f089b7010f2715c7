"""What was learned, on disk: an npz archive of plain arrays with a JSON header.

The header tells the version, the camera and the settings that the samples depend on; a model is
only taken up where they agree. The archive's comment, the last bytes of the file, is the SHA-256
of all before it. Nothing in the file is ever executed.
"""

import hashlib
import io
import json
import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import CompanionError, PlanError
from companion.learning.learner import LearnerState, dictionary_of
from companion.vision.textons import TextonDictionary

VERSION = 4
SCALE_TOLERANCE = 0.05
"""How much the disparity of the same depth may differ, as after a new calibration."""

MOST_BYTES = 1 << 30
"""A larger file is no model of ours; nobody shall be asked for the memory."""

_HEADER = "header.json"
_DIGEST_BYTES = 64
_DAMAGE = (
    OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, MemoryError, RuntimeError,
    struct.error, zlib.error, zipfile.BadZipFile,
)  # fmt: skip
"""What numpy and zipfile raise for an archive that was made to mislead them."""


class UnreadableModelError(PlanError):
    """No model, or one that was damaged: an older one may do."""


class _Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    version: int
    camera: StereoCalibration
    meaning: dict[str, str | int | float]
    flown_s: float = 0.0


class SavedModel(NamedTuple):
    """A model as it lies on disk."""

    state: LearnerState
    camera: StereoCalibration
    flown_s: float
    """How much of its plan had been flown."""


def save_model(
    path: Path, state: LearnerState, calibration: StereoCalibration, flown_s: float = 0.0
) -> None:
    """Writes what was learned; a crash on the way leaves the former file as it was."""
    data = _encode(state, _Header(VERSION, calibration, state.meaning, flown_s))
    unfinished = path.with_name(f".{path.name}.unfinished")
    try:
        with unfinished.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise CompanionError(f"{path}: model cannot be written: {error.strerror}") from error


def load_model(path: Path, calibration: StereoCalibration) -> SavedModel:
    """What was saved. Raises PlanError for no model, or one of another camera."""
    saved = _read(path)
    _check_camera(path, saved.camera, calibration)
    return saved


def load_dictionary(path: Path) -> TextonDictionary:
    """The textons of a saved model, whatever its camera. Raises PlanError where it has none."""
    dictionary = dictionary_of(_read(path).state)
    if dictionary is None:
        raise PlanError(f"{path}: model has no textons")
    return dictionary


def _encode(state: LearnerState, header: _Header) -> bytes:
    arrays = {_HEADER: np.frombuffer(msgspec.json.encode(header), np.uint8), **state.arrays}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]  # a name is never allow_pickle
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.comment = bytes(_DIGEST_BYTES)
    content = buffer.getvalue()[:-_DIGEST_BYTES]
    return content + _digest(content)


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _read(path: Path) -> SavedModel:
    arrays = _arrays(path, _checked_bytes(path))
    try:
        text = arrays.pop(_HEADER).tobytes()
        version = json.loads(text)["version"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UnreadableModelError(f"{path}: not a saved model") from error
    if version != VERSION:
        raise PlanError(f"{path}: model of version {version}; this program reads {VERSION}")
    try:
        header = msgspec.json.decode(text, type=_Header)
    except msgspec.ValidationError as error:
        raise PlanError(f"{path}: not a saved model: {error}") from error
    return SavedModel(LearnerState(arrays, header.meaning), header.camera, header.flown_s)


def _checked_bytes(path: Path) -> bytes:
    """The file's content, its checksum found right."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UnreadableModelError(f"{path}: not a saved model: above {MOST_BYTES} bytes")
        data = path.read_bytes()
    except FileNotFoundError:
        raise UnreadableModelError(f"{path}: no such file") from None
    except OSError as error:
        raise UnreadableModelError(f"{path}: not a saved model: {error.strerror}") from error
    if data[-_DIGEST_BYTES:] != _digest(data[:-_DIGEST_BYTES]):
        raise UnreadableModelError(
            f"{path}: not a saved model, or damaged: its checksum does not fit"
        )
    return data


def _arrays(path: Path, data: bytes) -> dict[str, NDArray[np.generic]]:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except _DAMAGE as error:
        raise UnreadableModelError(f"{path}: not a saved model") from error


def _check_camera(path: Path, saved: StereoCalibration, found: StereoCalibration) -> None:
    sizes = [f"{camera.width_px} x {camera.height_px}" for camera in (saved, found)]
    if sizes[0] != sizes[1]:
        raise PlanError(f"{path}: model of a {sizes[0]} camera; this one is {sizes[1]}")
    ratio = saved.disparity_metre_px / found.disparity_metre_px
    if abs(ratio - 1.0) > SCALE_TOLERANCE:
        raise PlanError(
            f"{path}: model of a camera with {saved.disparity_metre_px:.3g} px at 1 m; this one "
            f"has {found.disparity_metre_px:.3g} px; allowed is {SCALE_TOLERANCE:.0%} difference"
        )
