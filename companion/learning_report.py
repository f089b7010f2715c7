"""What a learner is judged by: its estimates, spreads, novelty and maps against stereo's."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.judging.performance import OnlinePerformance, roc_curve
from companion.learning.doubt import DEVIATIONS
from companion.learning.learner import MonoEstimate
from companion.vision.cells import CellMap

WANTED_TPR = 0.96
"""Where the paper reports its false positive rate (section IV)."""
NOVEL = 1.0
"""Novelty that hardly a frame of the place that was learned exceeds; see learning.novelty."""


class MapReport(msgspec.Struct, frozen=True, kw_only=True):
    """The map's cells against stereo's, row by row from the top left; NaN where undefined."""

    mse_over_variance: list[list[float]]
    auc: list[list[float]]
    n_test: list[list[int]]
    """Frames on which both knew the cell."""
    mse_over_variance_of_all: float
    """All cells of all frames together."""


class LearningReport(msgspec.Struct, frozen=True, kw_only=True):
    """One eye's estimate against stereo's λ; NaN where nothing defines a figure."""

    mse: float
    """Pixels squared."""
    mse_over_variance: float
    """Over the variance of stereo's λ: 1 is what always answering its mean would score."""
    auc: float
    tpr: float
    fpr: float
    threshold_px: float
    """Estimate above which tpr and fpr count a frame as detected."""
    fpr_at_tpr_0_96: float
    positive_threshold_px: float
    n_train: int
    """Frames learned from."""
    n_test: int
    """Frames scored: both stereo and one eye knew λ."""
    n_frames: int
    """Frames read, with those that taught the dictionary or had no λ."""
    coverage_0_5: float
    """Share of frames whose error is within the interval that should hold half of them."""
    coverage_0_8: float
    coverage_0_95: float
    auc_of_error: float
    """Chance that of two frames, one with an error above the median, that one states more."""
    novelty_median: float
    novel_norm: float
    """Share of frames with a novelty above 1."""
    map: MapReport | None = None
    """With learner.output = "map"."""


class Scores:
    """Estimates and what stereo said, frame by frame."""

    def __init__(self) -> None:
        self.stereo_px: list[float] = []
        self.mono_px: list[float] = []
        self._std_px: list[float] = []
        self._novelty: list[float] = []
        self._maps_px: list[tuple[CellMap, CellMap]] = []

    def add(self, mono: MonoEstimate, stereo_px: float, stereo_cells_px: CellMap | None) -> None:
        """A frame on which both eyes and one knew λ counts; others do not."""
        if math.isnan(mono.mono_px) or math.isnan(stereo_px):
            return
        self.stereo_px.append(stereo_px)
        self.mono_px.append(mono.mono_px)
        self._std_px.append(mono.std_px)
        self._novelty.append(mono.novelty)
        if mono.map_px is not None and stereo_cells_px is not None:
            self._maps_px.append((mono.map_px, stereo_cells_px))

    def report(
        self, positive_threshold_px: float, threshold_px: float, *, n_train: int, n_frames: int
    ) -> LearningReport:
        """All figures of the frames counted."""
        online = OnlinePerformance(positive_threshold_px)
        for mono_px, stereo_px in zip(self.mono_px, self.stereo_px, strict=True):
            online.update(mono_px, stereo_px, threshold_px)
        curve = roc_curve(self.mono_px, self.stereo_px, positive_threshold_px)
        error_px = np.abs(np.subtract(self.mono_px, self.stereo_px))
        coverage = [coverage_of(error_px, self._std_px, deviation) for deviation in DEVIATIONS]
        novelty = np.array(self._novelty)
        known = novelty[np.isfinite(novelty)]
        return LearningReport(
            mse=online.mse_px2,
            mse_over_variance=online.mse_over_variance,
            auc=curve.auc,
            tpr=online.tpr,
            fpr=online.fpr,
            threshold_px=threshold_px,
            fpr_at_tpr_0_96=curve.fpr_at_tpr(WANTED_TPR),
            positive_threshold_px=positive_threshold_px,
            n_train=n_train,
            n_test=online.n_samples,
            n_frames=n_frames,
            coverage_0_5=coverage[0],
            coverage_0_8=coverage[1],
            coverage_0_95=coverage[2],
            auc_of_error=auc_of_error(error_px, self._std_px),
            novelty_median=float(np.median(known)) if len(known) else math.nan,
            novel_norm=float(np.mean(known > NOVEL)) if len(known) else math.nan,
            map=map_report(self._maps_px, positive_threshold_px) if self._maps_px else None,
        )


def coverage_of(error_px: NDArray[np.float64], std_px: Sequence[float], deviation: float) -> float:
    """Share of errors within so many stated deviations; NaN without frames."""
    within = error_px <= deviation * np.asarray(std_px)
    return float(np.mean(within)) if len(within) else math.nan


def auc_of_error(error_px: NDArray[np.float64], std_px: Sequence[float]) -> float:
    """How well the stated deviation tells large errors, those above the median, from small."""
    if not len(error_px):
        return math.nan
    return roc_curve(std_px, error_px, float(np.median(error_px))).auc


def map_report(
    maps_px: Sequence[tuple[CellMap, CellMap]], positive_threshold_px: float
) -> MapReport:
    """Of pairs (estimated, measured)."""
    mono, stereo = (np.stack(maps).astype(np.float64) for maps in zip(*maps_px, strict=True))
    rows, columns = mono.shape[1:]
    cells = [[(mono[:, r, c], stereo[:, r, c]) for c in range(columns)] for r in range(rows)]
    return MapReport(
        mse_over_variance=[[mse_over_variance(*cell) for cell in row] for row in cells],
        auc=[[roc_curve(*cell, positive_threshold_px).auc for cell in row] for row in cells],
        n_test=[[int(np.isfinite(cell[1]).sum()) for cell in row] for row in cells],
        mse_over_variance_of_all=mse_over_variance(mono.reshape(-1), stereo.reshape(-1)),
    )


def mse_over_variance(mono_px: NDArray[np.float64], stereo_px: NDArray[np.float64]) -> float:
    """1 is what always answering stereo's mean would score; NaN where stereo knew too little."""
    known = np.isfinite(stereo_px)
    variance = float(stereo_px[known].var()) if known.any() else 0.0
    if variance == 0.0:
        return math.nan
    return float(np.mean((mono_px[known] - stereo_px[known]) ** 2)) / variance
