"""Features of one recording, worked out where they are needed and kept on the disk."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.learning.learner import Learner
from companion.vision.features import Features, Grey
from tools.offline.store import save_array


class KeptFeatures:
    """Of ``n_frames`` images; a row is NaN until it was asked for."""

    def __init__(self, path: Path, n_frames: int, learner: Learner) -> None:
        self._path = path
        self._n_frames = n_frames
        self._learner = learner
        self._grew = False
        self._rows: NDArray[np.float32] | None = np.load(path) if path.is_file() else None

    def of(self, row: int, image: Callable[[], Grey]) -> Features:
        """Features (n_features,) of a row's image, which is looked at only where it must be."""
        if self._rows is None or np.isnan(self._rows[row, 0]):
            features = self._learner.observe(image())
            assert features is not None, "the dictionary comes first"
            if self._rows is None:
                self._rows = np.full((self._n_frames, len(features)), np.nan, dtype=np.float32)
            self._rows[row] = features
            self._grew = True
        return np.asarray(self._rows[row])

    def save(self) -> None:
        """With what others have kept meanwhile; what two save at once is worked out again."""
        if self._rows is None or not self._grew:
            return
        if self._path.is_file():
            theirs = np.load(self._path)
            self._rows = np.where(np.isnan(self._rows), theirs, self._rows)
        save_array(self._path, self._rows)
