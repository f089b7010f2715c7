"""How well one cue stands in for the other: ROC curve, thresholds, running counts (section III-E).

A sample is positive where its label exceeds the positive threshold, and detected where its score
exceeds the score threshold: always "greater than", as in the paper. Pairs with a NaN on either
side do not count; a rate without samples to base it on is NaN.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class RocCurve(NamedTuple):
    """Corner points from "nothing detected" to "everything detected", each of shape (n_points,).

    ``score > threshold_px[i]`` gives exactly ``fpr[i]`` and ``tpr[i]``.
    """

    fpr: Floats
    tpr: Floats
    threshold_px: Floats

    @property
    def auc(self) -> float:
        """Chance that a positive scores above a negative, ties counting half."""
        if np.isnan(self.fpr[0]) or np.isnan(self.tpr[0]):
            return math.nan
        return float(np.sum(np.diff(self.fpr) * (self.tpr[1:] + self.tpr[:-1])) / 2.0)

    def fpr_at_tpr(self, wanted_tpr: float) -> float:
        """Lowest false positive rate that comes with at least ``wanted_tpr``."""
        index = self._corner(wanted_tpr)
        return math.nan if index is None else float(self.fpr[index])

    def threshold_at_tpr_px(self, wanted_tpr: float) -> float:
        """Highest threshold that still gives at least ``wanted_tpr``."""
        index = self._corner(wanted_tpr)
        return math.nan if index is None else float(self.threshold_px[index])

    def _corner(self, wanted_tpr: float) -> int | None:
        if np.isnan(self.tpr).any():
            return None
        # A hair of slack: 24 of 25 must count as 0.96.
        reached = np.flatnonzero(self.tpr >= wanted_tpr - 1e-12)
        return int(reached[0])


def roc_curve(scores_px: ArrayLike, labels_px: ArrayLike, positive_threshold_px: float) -> RocCurve:
    """ROC of ``scores_px`` against ``labels_px > positive_threshold_px``, both (n_samples,).

    Rates are NaN where there are no positives (tpr) or no negatives (fpr).
    """
    scores, labels = _known_pairs(scores_px, labels_px)
    positive = labels > positive_threshold_px
    order = np.argsort(-scores, kind="stable")
    scores, positive = scores[order], positive[order]
    last_of_tie = np.flatnonzero(np.diff(scores, append=-np.inf))
    detected = last_of_tie + 1
    true_positives = np.cumsum(positive, dtype=np.int64)[last_of_tie]
    return RocCurve(
        fpr=_rates(detected - true_positives, int(np.count_nonzero(~positive))),
        tpr=_rates(true_positives, int(np.count_nonzero(positive))),
        threshold_px=_between(scores[last_of_tie]),
    )


def threshold_for_tpr_px(
    scores_px: ArrayLike, labels_px: ArrayLike, positive_threshold_px: float, wanted_tpr: float
) -> float:
    """Highest score threshold that detects ``wanted_tpr`` of the positives; NaN without any."""
    scores, labels = _known_pairs(scores_px, labels_px)
    positives = np.count_nonzero(labels > positive_threshold_px)
    if not positives:
        return math.nan
    return roc_curve(scores, labels, positive_threshold_px).threshold_at_tpr_px(wanted_tpr)


class OnlinePerformance:
    """Running error and confusion counts of an estimate against its label, O(1) per sample."""

    def __init__(self, positive_threshold_px: float) -> None:
        self.positive_threshold_px = positive_threshold_px
        self.n_samples = 0
        self.true_positives = 0
        self.false_positives = 0
        self.true_negatives = 0
        self.false_negatives = 0
        self._squared_error_px2 = 0.0
        self._label_mean_px = 0.0
        self._label_scatter_px2 = 0.0

    def update(self, estimate_px: float, label_px: float, threshold_px: float) -> None:
        """Counts one sample, detected where ``estimate_px > threshold_px``; skips unknowns."""
        if math.isnan(estimate_px) or math.isnan(label_px) or math.isnan(threshold_px):
            return
        self.n_samples += 1
        self._squared_error_px2 += (estimate_px - label_px) ** 2
        deviation_px = label_px - self._label_mean_px
        self._label_mean_px += deviation_px / self.n_samples
        self._label_scatter_px2 += deviation_px * (label_px - self._label_mean_px)
        self._count(estimate_px > threshold_px, label_px > self.positive_threshold_px)

    def _count(self, detected: bool, positive: bool) -> None:
        if positive:
            self.true_positives += detected
            self.false_negatives += not detected
        else:
            self.false_positives += detected
            self.true_negatives += not detected

    @property
    def mse_px2(self) -> float:
        return _ratio(self._squared_error_px2, self.n_samples)

    @property
    def mse_over_variance(self) -> float:
        """1 is what always answering the labels' mean would score."""
        return _ratio(self._squared_error_px2, self._label_scatter_px2)

    @property
    def tpr(self) -> float:
        return _ratio(self.true_positives, self.true_positives + self.false_negatives)

    @property
    def fpr(self) -> float:
        return _ratio(self.false_positives, self.false_positives + self.true_negatives)


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0 else math.nan


def _known_pairs(scores_px: ArrayLike, labels_px: ArrayLike) -> tuple[Floats, Floats]:
    scores = np.asarray(scores_px, dtype=np.float64)
    labels = np.asarray(labels_px, dtype=np.float64)
    known = ~(np.isnan(scores) | np.isnan(labels))
    return scores[known], labels[known]


def _rates(counts: NDArray[np.int64], total: int) -> Floats:
    """``counts / total`` behind a leading 0; NaN throughout where nothing was to be counted."""
    rates = np.zeros(len(counts) + 1)
    rates[1:] = counts
    return rates / total if total else np.full(len(rates), np.nan)


def _between(descending_scores: Floats) -> Floats:
    """Thresholds halfway between neighbouring scores, so that new data may differ a little."""
    if not len(descending_scores):
        return np.array([np.inf])
    halfway = (descending_scores[:-1] + descending_scores[1:]) / 2.0
    lowest = np.nextafter(descending_scores[-1], -np.inf)
    # Scores one float apart have no number between them: the lower one still separates them.
    halfway = np.where(halfway < descending_scores[:-1], halfway, descending_scores[1:])
    return np.concatenate([[np.inf], halfway, [lowest]])
