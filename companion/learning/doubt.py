"""How wrong a regressor is where it has not just learned: makes its stated spread true.

Neighbouring frames are near-copies, so the error on the next frame flatters. A copy of the
regressor that has learned nothing for a while is asked instead, now and then, and its errors
against stereo are compared with the spread that it stated.
"""

from collections import deque
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from companion.kernel.parts import Arrays
from companion.regressors.base import Predictor

STRETCH_FRAMES = 100
"""A copy is asked for this long, when it has learned nothing for as long."""
EVERY_FRAMES = 4
REMEMBERED = 400
LEAST_ANSWERS = 40
"""Before, the stated spread is taken as it is."""
SHARES = (0.5, 0.8, 0.95)
"""Of the errors that shall lie within as many deviations as they would of a normal one."""
DEVIATIONS = tuple(float(norm.ppf(0.5 + share / 2.0)) for share in SHARES)


class Copied(Protocol):
    """A regressor that hands out copies."""

    def snapshot(self) -> Predictor:
        """The model as it is now."""
        ...


class Doubt:
    """Corrects spreads: ``factor * sqrt(spread² + least²)``, both from the errors seen."""

    def __init__(self) -> None:
        self._n_frames = 0
        self._young: Predictor | None = None
        self._old: Predictor | None = None
        self._answers: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)
        self._factor, self._least = 1.0, 0.0

    def witness(self, regressor: Copied) -> Predictor | None:
        """To be called once per frame, before a trained regressor learns it: whom to ask, if any.

        Tell ``note`` what came of it.
        """
        if self._n_frames % STRETCH_FRAMES == 0:
            self._old, self._young = self._young, regressor.snapshot()
        self._n_frames += 1
        return self._old if self._n_frames % EVERY_FRAMES == 0 else None

    def note(self, error: float, spread: float) -> None:
        """Of a witness; an unknown spread counts as none."""
        self._answers.append((abs(error), float(np.nan_to_num(spread))))
        if len(self._answers) >= LEAST_ANSWERS:
            self._correct()

    def widen(self, spread: NDArray[np.float64]) -> NDArray[np.float64]:
        """The corrected spread; as stated while there are few answers."""
        if len(self._answers) < LEAST_ANSWERS:
            return spread
        return np.asarray(self._factor * np.hypot(np.fmax(spread, 0.0), self._least))

    def state(self) -> Arrays:
        """The answers remembered, (n, 2): errors and spreads."""
        return {"answers": np.array(self._answers).reshape(-1, 2)}

    def restore(self, state: Arrays) -> None:
        """Takes up where ``state`` was taken; copies of the regressor are made anew."""
        self._answers.clear()
        for error, spread in np.asarray(state["answers"], dtype=np.float64) if state else ():
            self.note(float(error), float(spread))

    def _correct(self) -> None:
        errors, spreads = np.array(self._answers).T
        # Half of the errors exceed what they are usually: no spread is believed below that.
        self._least = float(np.median(errors)) / DEVIATIONS[0]
        ratios = errors / np.maximum(np.hypot(spreads, self._least), 1e-9)
        found = np.maximum(np.quantile(ratios, SHARES), 1e-9)
        self._factor = float(np.exp(np.mean(np.log(found / DEVIATIONS))))
