"""From surveys to what is wrong with each eye: one frame's signs, not yet a verdict.

Limits stand well outside of what healthy cameras show in any room
(tests/companion/health/test_health.py).
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.health.survey import Survey, survey
from companion.health.tears import (
    LEAST_SEAM_RATIO,
    SEAM_RATIO,
    apart_between_eyes,
    apart_from_last,
    seams,
)
from companion.kernel.messages import CameraFault

Grey = NDArray[np.uint8]

DARK_NORM = 0.95
BRIGHT_NORM = 0.7
LEAST_PART_NORM = 0.1
"""Of the rows, old or empty."""
PLAIN_LSB = 3.0
"""A cell with less contrast in both eyes says nothing."""
FADED_NORM = 0.5
"""Contrast over the other eye's, below which a cell counts as faded; and so must all together."""
FADED_CELLS_NORM = 0.5
"""Of the cells that say something; and at least LEAST_CELLS of them."""
LEAST_CELLS = 3
COLLAPSE_S = 0.35
"""Both eyes' contrast has gone where it falls within this time to less than GONE_NORM; a scene
turns away slower. It is back above BACK_NORM."""
GONE_NORM, BACK_NORM = 0.5, 0.7


class Sign(NamedTuple):
    """A fault as one frame shows it, with the figures that show it."""

    fault: CameraFault
    evidence: str


class Eyes:
    """Looks at pair after pair."""

    def __init__(self) -> None:
        self._previous: list[Grey | None] = [None, None]
        self._usual = [UsualContrast(), UsualContrast()]

    def look(self, left: Grey, right: Grey, period_s: float) -> tuple[Sign | None, Sign | None]:
        """What each eye shows. An image of shape (0, 0) is one that did not come."""
        images = left, right
        surveys = [
            survey(image, before) if image.size else None
            for image, before in zip(images, self._previous, strict=True)
        ]
        own = [_own_sign(one) for one in surveys]
        faded = [
            one is not None and usual.has_gone(one.mean_contrast_lsb, period_s)
            for one, usual in zip(surveys, self._usual, strict=True)
        ]
        signs = [own[eye] or _contrast(surveys, own, faded, eye) for eye in (0, 1)]
        signs = _tears(images, signs, self._previous)
        self._previous = [left, right]
        return signs[0], signs[1]


class UsualContrast:
    """Contrast of the last moments of one eye, and whether it has gone all at once."""

    def __init__(self) -> None:
        self._recent_lsb: deque[tuple[float, float]] = deque()
        self._time_s = 0.0
        self._lost_lsb: float | None = None
        """What it was before it went."""

    def has_gone(self, contrast_lsb: float, period_s: float) -> bool:
        """One image on. Gone contrast is gone until most of it is back."""
        self._time_s += period_s
        while self._recent_lsb and self._time_s - self._recent_lsb[0][0] > COLLAPSE_S:
            self._recent_lsb.popleft()
        if self._lost_lsb is None:
            most_lsb = max((lsb for _, lsb in self._recent_lsb), default=contrast_lsb)
            self._lost_lsb = most_lsb if contrast_lsb < GONE_NORM * most_lsb else None
        elif contrast_lsb > BACK_NORM * self._lost_lsb:
            self._lost_lsb = None
        self._recent_lsb.append((self._time_s, contrast_lsb))
        return self._lost_lsb is not None


def _own_sign(own: Survey | None) -> Sign | None:
    """What needs no other eye; the first that applies explains those below it."""
    if own is None:
        return Sign(CameraFault.NO_FRAMES, "no image")
    return _light(own) or _rows(own)


def _light(own: Survey) -> Sign | None:
    if own.black_norm > DARK_NORM:
        return Sign(CameraFault.BLACK, f"{own.black_norm:.0%} of the pixels black")
    if own.white_norm > BRIGHT_NORM:
        return Sign(CameraFault.SATURATED, f"{own.white_norm:.0%} of the pixels white")
    return None


def _rows(own: Survey) -> Sign | None:
    if own.stale_norm == 1.0:
        return Sign(CameraFault.FROZEN, "no pixel changed")
    if own.stale_norm > LEAST_PART_NORM:
        return Sign(CameraFault.HALF, f"{own.stale_norm:.0%} of the rows old")
    if own.flat_norm > LEAST_PART_NORM:
        return Sign(CameraFault.HALF, f"{own.flat_norm:.0%} of the rows empty")
    return None


def _tears(
    images: Sequence[Grey], others: Sequence[Sign | None], last: Sequence[Grey | None]
) -> list[Sign | None]:
    """Adds what is torn to the other signs."""
    signs = list(others)
    sound = [eye for eye in (0, 1) if others[eye] is None]
    for eye in sound:
        if apart_from_last(images[eye], last[eye]):
            signs[eye] = Sign(CameraFault.TORN, "fits the last image at one end only")
    if len(sound) == 2 and not any(signs) and apart_between_eyes(images[0], images[1]):
        excess = seams(images[0], images[1])
        for eye in sound:
            if excess[eye] >= max(LEAST_SEAM_RATIO, min(SEAM_RATIO, max(excess))):
                text = f"fits the other eye at one end only, seam {excess[eye]:+.1f}"
                signs[eye] = Sign(CameraFault.TORN, text)
    return signs


def _contrast(
    surveys: Sequence[Survey | None], own: Sequence[Sign | None], faded: Sequence[bool], eye: int
) -> Sign | None:
    """Less than in the other eye, where that is sound; less in both than a moment ago."""
    mine, other = surveys[eye], surveys[1 - eye]
    if mine is None:
        return None
    if other is None or own[1 - eye] is not None:
        return _gone(mine) if faded[eye] else None
    if all(faded):
        return _gone(mine)
    telling = other.contrast_lsb > PLAIN_LSB
    n_telling = int(telling.sum())
    weak = telling & (mine.contrast_lsb < FADED_NORM * other.contrast_lsb)
    if n_telling < LEAST_CELLS or weak.sum() < FADED_CELLS_NORM * n_telling:
        return None
    ratio = mine.mean_contrast_lsb / other.mean_contrast_lsb
    if ratio > FADED_NORM:
        return None
    return Sign(CameraFault.BLURRED, f"contrast {ratio:.0%} of the other eye's")


def _gone(mine: Survey) -> Sign:
    return Sign(CameraFault.BLURRED, f"contrast down to {mine.mean_contrast_lsb:.1f}")
