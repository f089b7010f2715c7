"""What was learned, on disk: an npz archive of plain arrays with a JSON header.

The header tells the version, the camera and the settings that the samples depend on; a model is
only taken up where they agree. Nothing in the file is ever executed.
"""

import json
import os
import zipfile
from pathlib import Path

import msgspec
import numpy as np

from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import CompanionError, PlanError
from companion.learner import LearnerState, dictionary_of
from companion.textons import TextonDictionary

VERSION = 2
SCALE_TOLERANCE = 0.05
"""How much the disparity of the same depth may differ, as after a new calibration."""

_HEADER = "header.json"


class _Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    version: int
    camera: StereoCalibration
    meaning: dict[str, str | int | float]


def save_model(path: Path, state: LearnerState, calibration: StereoCalibration) -> None:
    """Writes what was learned; a crash on the way leaves the former file as it was."""
    header = msgspec.json.encode(_Header(VERSION, calibration, state.meaning))
    arrays = {_HEADER: np.frombuffer(header, np.uint8), **state.arrays}
    unfinished = path.with_name(f".{path.name}.unfinished")
    try:
        with unfinished.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # a name is never allow_pickle
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise CompanionError(f"{path}: model cannot be written: {error.strerror}") from error


def load_model(path: Path, calibration: StereoCalibration) -> LearnerState:
    """What was saved. Raises PlanError for no model, or one of another camera."""
    camera, state = _read(path)
    _check_camera(path, camera, calibration)
    return state


def load_dictionary(path: Path) -> TextonDictionary:
    """The textons of a saved model, whatever its camera. Raises PlanError where it has none."""
    dictionary = dictionary_of(_read(path)[1])
    if dictionary is None:
        raise PlanError(f"{path}: model has no textons")
    return dictionary


def _read(path: Path) -> tuple[StereoCalibration, LearnerState]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        text = arrays.pop(_HEADER).tobytes()
        version = json.loads(text)["version"]
    except FileNotFoundError:
        raise PlanError(f"{path}: no such file") from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError) as error:
        raise PlanError(f"{path}: not a saved model") from error
    except zipfile.BadZipFile as error:
        raise PlanError(f"{path}: not a saved model, or cut short") from error
    if version != VERSION:
        raise PlanError(f"{path}: model of version {version}; this program reads {VERSION}")
    try:
        header = msgspec.json.decode(text, type=_Header)
    except msgspec.ValidationError as error:
        raise PlanError(f"{path}: not a saved model: {error}") from error
    return header.camera, LearnerState(arrays, header.meaning)


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
