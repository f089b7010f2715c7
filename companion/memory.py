"""Memory across flights: what was learned, saved in flight and at landing, and found again.

Beside the newest model lies the one saved before it, so that one of both is whole whatever happens
while the newest is written, or to it later.
"""

import logging
import threading
from pathlib import Path
from typing import NamedTuple

from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import CompanionError, PlanError
from companion.learning.learner import Learner, LearnerState
from companion.modelfile import SavedModel, UnreadableModelError, load_model, save_model

MODEL_NAME = "model.npz"
DISK_LIMIT_S = 20.0
"""Wall time that a save may take before landing goes on without it."""

logger = logging.getLogger(__name__)


class Recalled(NamedTuple):
    """A model of an earlier flight, and the file it was read from."""

    path: Path
    saved: SavedModel

    def teach(self, learner: Learner) -> None:
        """Raises PlanError where the learner's settings are others than the model's."""
        try:
            learner.restore(self.saved.state)
        except PlanError as error:
            raise PlanError(f"{self.path}: {error}") from error


def previous_of(path: Path) -> Path:
    """Where the model saved before the one in ``path`` lies."""
    return path.with_stem(f"{path.stem}.previous")


def recall(where: Path, calibration: StereoCalibration) -> Recalled:
    """The model in a file, in a flight's folder, or of the newest flight in a folder of flights.

    One that cannot be read is replaced by the one saved before it. Raises PlanError where there is
    none, or it is another camera's.
    """
    path = _newest_in(where) if where.is_dir() else where
    try:
        return Recalled(path, load_model(path, calibration))
    except UnreadableModelError as error:
        previous = previous_of(path)
        if not previous.is_file():
            raise
        logger.warning("%s; taking the one saved before it, %s", error, previous)
        return Recalled(previous, load_model(previous, calibration))


def newest_flight_in(folder: Path) -> Path | None:
    """Of flights' folders, whose names begin with their dates, the last that left a model."""
    flights = [path for path in folder.iterdir() if path.is_dir() and has_model(path)]
    return max(flights, key=lambda path: path.name, default=None)


def has_model(folder: Path) -> bool:
    """Whether a flight left one in its folder."""
    newest = folder / MODEL_NAME
    return newest.is_file() or previous_of(newest).is_file()


def _newest_in(folder: Path) -> Path:
    flight = folder if has_model(folder) else newest_flight_in(folder)
    if flight is None:
        raise PlanError(f"{folder}: no {MODEL_NAME} in it, nor in a flight's folder in it")
    return flight / MODEL_NAME


class ModelKeeper:
    """Saves what was learned to ``path`` while the flight goes on, on a thread of its own.

    ``patient``: a save that is still under way is waited for, as where simulated time waits for
    everybody; else the new one is left out.
    """

    def __init__(
        self, path: Path, calibration: StereoCalibration, period_s: float, patient: bool
    ) -> None:
        self._path = path
        self._calibration = calibration
        self._period_ns = round(period_s * 1e9)
        """0: only at landing."""
        self._patient = patient
        self._due_ns: int | None = None
        self._saving: threading.Thread | None = None

    def offer(self, stamp_ns: int, learner: Learner, flown_s: float) -> None:
        """To be called after every frame; saves when it is time to."""
        if self._due_ns is None:
            self._due_ns = stamp_ns + self._period_ns
        if not self._period_ns or stamp_ns < self._due_ns:
            return
        self._due_ns = stamp_ns + self._period_ns
        if self._busy(DISK_LIMIT_S if self._patient else 0.0):
            logger.warning("%s: the last save is still under way; leaving one out", self._path)
            return
        # A daemon: a disk that never answers must not keep the process from ending.
        self._saving = threading.Thread(
            target=self._save_in_flight, args=(learner.state(), flown_s), name="model", daemon=True
        )
        self._saving.start()

    def finish(self, learner: Learner, flown_s: float) -> None:
        """Saves at the end of a flight. Raises CompanionError."""
        if self._busy(DISK_LIMIT_S):
            raise CompanionError(
                f"{self._path}: model cannot be written: a save has taken {DISK_LIMIT_S:.0f} s"
            )
        self._save(learner.state(), flown_s)

    def _busy(self, limit_s: float) -> bool:
        """Whether a save is under way, still after waiting this long."""
        if self._saving is not None:
            self._saving.join(limit_s)
        return self._saving is not None and self._saving.is_alive()

    def _save_in_flight(self, state: LearnerState, flown_s: float) -> None:
        try:
            self._save(state, flown_s)
        except CompanionError as error:
            logger.warning("%s", error)  # the flight goes on: it can still be saved at landing

    def _save(self, state: LearnerState, flown_s: float) -> None:
        """The former newest stays as the previous; at any moment one of them is whole."""
        unproven = self._path.with_name(f".{self._path.name}.new")
        save_model(unproven, state, self._calibration, flown_s)
        try:
            if self._path.exists():
                self._path.replace(previous_of(self._path))
            unproven.replace(self._path)
        except OSError as error:
            raise CompanionError(
                f"{self._path}: model cannot be written: {error.strerror}"
            ) from error
