"""From what was seen to λ: how regressors are taught and asked.

One estimator answers with one figure for the whole image, the other with a map of which the
figure is the mean. Both learn from stereo's disparity map and forget nothing when it is gone.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from companion import regressors
from companion.kernel.parts import Arrays, part, whole
from companion.learning.doubt import Doubt
from companion.learning.learner_settings import LearnerSettings, Target
from companion.regressors import Predictor, Regressor, RidgeRegressor
from companion.vision import gradients
from companion.vision.cells import CELLS, COLUMNS, ROWS, cell_labels
from companion.vision.features import OF_VIEWS, Extractor, Features, Grey
from companion.vision.views import views_of

Floats = NDArray[np.float64]
MapOf = Callable[[], NDArray[np.float32]]
"""Gives the disparity map (height, width) of the pair just matched, NaN where unmatched."""

LOG_OFFSET_PX, LOG_FLOOR_PX = 0.5, -0.4
"""log(λ + offset) is learned, of λ no less than the floor; a poor calibration makes λ negative."""
MAP_ALPHA, MAP_REFRESH = 50.0, 0.02
"""Cells of one image are alike, so that many of them count as one; see RidgeRegressor."""
PLACES: Features = np.concatenate(
    [np.repeat(np.eye(ROWS), COLUMNS, axis=0), np.tile(np.eye(COLUMNS), (ROWS, 1))], axis=1
).astype(np.float32)
"""Row and column of each cell, one value each: (CELLS, ROWS + COLUMNS)."""


class Seen(NamedTuple):
    """Features of an image (height, width), and the image itself where it is at hand."""

    features: Features
    image: Grey | None
    nearness_per_m: float = math.nan
    """By companion.vision.parallax, where the vehicle moves."""


class Estimate(NamedTuple):
    """λ and its standard deviation; ``map_px`` (ROWS, COLUMNS) where there is a map."""

    mono_px: float
    std_px: float
    map_px: NDArray[np.float32] | None = None


class Estimator(Protocol):
    """What a learner asks and teaches."""

    @property
    def trained(self) -> bool:
        """True once there is an answer."""
        ...

    def estimate(self, seen: Seen) -> Estimate:
        """λ of what was seen. It must be trained."""
        ...

    def learn(self, seen: Seen, disparity_px: float, map_of: MapOf | None) -> bool:
        """Takes stereo's λ, and its map, as the truth; True if that could be used."""
        ...

    def state(self) -> Arrays:
        """All that was learned; empty before that."""
        ...

    def restore(self, state: Arrays) -> None:
        """Takes up where ``state`` was taken."""
        ...


class Scale:
    """λ as regressors learn it, and back: within the range that stereo has reported so far."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self.range_px = np.array([math.inf, -math.inf])

    def widen(self, disparities_px: Floats) -> None:
        self.range_px[0] = min(self.range_px[0], disparities_px.min())
        self.range_px[1] = max(self.range_px[1], disparities_px.max())

    def targets(self, disparities_px: Floats) -> Floats:
        if self._target == "linear":
            return disparities_px
        return np.asarray(np.log(np.maximum(disparities_px, LOG_FLOOR_PX) + LOG_OFFSET_PX))

    def state(self) -> Arrays:
        return {"range_px": self.range_px.copy()}

    def restore(self, state: Arrays) -> None:
        if state:
            self.range_px = np.array(state["range_px"], dtype=np.float64)

    def in_pixels(self, mean: Floats, std: Floats) -> tuple[Floats, Floats]:
        """A regressor's answers, and their spread, as λ."""
        least_px, most_px = self.range_px
        if self._target == "log":
            mean = np.exp(np.minimum(mean, math.log(most_px + 1.0)))
            mean, std = mean - LOG_OFFSET_PX, mean * std
        return np.clip(mean, least_px, most_px), std


class Taught:
    """A regressor, the scale of what it learns, and how far its stated spread can be believed."""

    def __init__(
        self, settings: LearnerSettings, regressor: Regressor, rng: np.random.Generator
    ) -> None:
        self._n_views = settings.design.views
        self._rng = rng
        self._regressor = regressor
        self._scale = Scale(settings.design.target)
        self._doubt = Doubt()
        self.trained = False

    def state(self) -> Arrays:
        if not self.trained:
            return {}
        return whole(
            regressor=self._regressor.state(),
            scale=self._scale.state(),
            doubt=self._doubt.state(),
        )

    def restore(self, state: Arrays) -> None:
        self.trained = bool(state)
        self._regressor.restore(part(state, "regressor"))
        self._scale.restore(part(state, "scale"))
        self._doubt.restore(part(state, "doubt"))


class ScalarEstimator(Taught):
    """One figure: the regressor's answer to the features of the whole image."""

    def __init__(self, settings: LearnerSettings, rng: np.random.Generator) -> None:
        self._kind = settings.design.features
        parameters = regressors.RegressorSettings(
            k=settings.k,
            capacity=settings.capacity,
            keep=settings.keep,
            seed=int(rng.integers(2**31)),
        )
        super().__init__(settings, regressors.make(settings.design.regressor, parameters), rng)

    def estimate(self, seen: Seen) -> Estimate:
        mean, std = self._regressor.predict(seen.features[np.newaxis], return_std=True)
        mean_px, std_px = self._scale.in_pixels(mean, self._doubt.widen(std))
        return Estimate(float(mean_px[0]), float(std_px[0]))

    def learn(self, seen: Seen, disparity_px: float, map_of: MapOf | None) -> bool:
        """With image and map, further views of it are learned from too."""
        samples, disparities_px = [seen.features], [disparity_px]
        if self._n_views and map_of and seen.image is not None:
            for view in views_of(seen.image, map_of(), disparity_px, self._n_views, self._rng):
                samples.append(OF_VIEWS[self._kind](view.view))
                disparities_px.append(view.disparity_px)
        targets = self._scale.targets(np.array(disparities_px))
        if self.trained:
            self._judge(samples[0], float(targets[0]))
        self._regressor.partial_fit(np.stack(samples), targets)
        self._scale.widen(np.array([disparity_px]))
        self.trained = True
        return True

    def _judge(self, sample: Features, target: float) -> None:
        witness = self._doubt.witness(self._regressor)
        if witness is not None:
            mean, std = witness.predict(sample[np.newaxis], return_std=True)
            self._doubt.note(float(mean[0]) - target, float(std[0]))


class MapEstimator(Taught):
    """A map: one ridge for all cells, from each cell, what is around it and where it lies.

    The image's λ is the mean of its cells, each counting by how often stereo could measure it.
    """

    def __init__(
        self, settings: LearnerSettings, extractor: Extractor, rng: np.random.Generator
    ) -> None:
        super().__init__(settings, RidgeRegressor(alpha=MAP_ALPHA, refresh=MAP_REFRESH), rng)
        self._extractor = extractor
        self._matches = np.zeros((ROWS, COLUMNS))
        """Sum of each cell's shares of matched pixels."""

    def estimate(self, seen: Seen) -> Estimate:
        estimate = self._ask(self._regressor, self._described(seen))
        widened = float(self._doubt.widen(np.array(estimate.std_px)))
        return estimate._replace(std_px=widened)

    def learn(self, seen: Seen, disparity_px: float, map_of: MapOf | None) -> bool:
        """Only cells that stereo measured teach; False where it measured none."""
        if map_of is None:
            return False
        map_px = map_of()
        labels = cell_labels(map_px)
        rows, targets = [self._described(seen)], [labels.disparity_px.reshape(-1)]
        if self._n_views and seen.image is not None:
            for view in views_of(seen.image, map_px, disparity_px, self._n_views, self._rng):
                rows.append(described(gradients.encode_cells(view.view)))
                targets.append(cell_labels(view.map_px).disparity_px.reshape(-1) * view.zoom)
        known_px = np.concatenate(targets).astype(np.float64)
        known = np.isfinite(known_px)
        if not known[:CELLS].any():
            return False
        if self.trained:
            self._judge(rows[0], disparity_px)
        self._regressor.partial_fit(
            np.concatenate(rows)[known], self._scale.targets(known_px[known])
        )
        self._matches += labels.valid_norm
        self._scale.widen(known_px[:CELLS][known[:CELLS]])
        self.trained = True
        return True

    def state(self) -> Arrays:
        learned = super().state()
        return learned | whole(cells={"matches": self._matches.copy()}) if learned else {}

    def restore(self, state: Arrays) -> None:
        super().restore(state)
        if state:
            self._matches = np.array(state["cells.matches"], dtype=np.float64)

    def _ask(self, model: Predictor, cells: Features) -> Estimate:
        """The model's map, and its mean; spread: the cells' mean, for they err together."""
        answer = self._scale.in_pixels(*model.predict(cells, return_std=True))
        map_px, std_px = (values.reshape(ROWS, COLUMNS) for values in answer)
        weights = self._matches / self._matches.sum()
        mono_px, mono_std_px = float((weights * map_px).sum()), float((weights * std_px).sum())
        return Estimate(mono_px, mono_std_px, map_px.astype(np.float32))

    def _judge(self, cells: Features, disparity_px: float) -> None:
        witness = self._doubt.witness(self._regressor)
        if witness is not None:
            answer = self._ask(witness, cells)
            self._doubt.note(answer.mono_px - disparity_px, answer.std_px)

    def _described(self, seen: Seen) -> Features:
        if seen.image is None:
            raise ValueError("a map needs the image, not only its features")
        return described(self._extractor.cells(seen.image))


def make_estimator(
    settings: LearnerSettings, extractor: Extractor, rng: np.random.Generator
) -> Estimator:
    """Of the output that the plan asks for."""
    if settings.output == "map":
        return MapEstimator(settings, extractor, rng)
    return ScalarEstimator(settings, rng)


def described(cells: Features) -> Features:
    """What the ridge sees of each cell: itself, its neighbourhood, the image, and its place.

    cells: (CELLS, n); returns (CELLS, 3 n + ROWS + COLUMNS).
    """
    grid = cells.reshape(ROWS, COLUMNS, -1)
    padded = np.pad(grid, ((1, 1), (1, 1), (0, 0)), mode="edge")
    down = padded[:-2] + padded[1:-1] + padded[2:]
    around = (down[:, :-2] + down[:, 1:-1] + down[:, 2:]).reshape(CELLS, -1) / np.float32(9.0)
    everywhere = np.broadcast_to(cells.mean(axis=0), cells.shape)
    return np.concatenate([cells, around, everywhere, PLACES], axis=1, dtype=np.float32)
