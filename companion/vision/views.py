"""Views that were never taken: parts of an image enlarged, as if the camera had flown nearer.

A crop enlarged z times is what a lens z times longer sees, and so close to what this lens sees
z times nearer; stereo's disparity in the crop grows by the same z, and is its label. A vehicle
that turns away before walls has few near samples, and gets them from far ones. Mirrored views
double them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.vision import gradients

Grey = NDArray[np.uint8]
Floats32 = NDArray[np.float32]

MOST_ZOOM = 8.0
LEAST_VALID_NORM = 0.15
"""A crop with fewer matches has no label."""
NOISE_LSB = 1.5
"""Enlarging smooths the camera's noise away; without it, smoothness would mean near."""


class Sample(NamedTuple):
    """A view (gradients.HEIGHT_PX, gradients.WIDTH_PX), and its average disparity."""

    view: Floats32
    disparity_px: float
    map_px: Floats32
    """The disparities measured in the part that it shows; ``zoom`` times them are the view's."""
    zoom: float


def views_of(
    image: Grey, map_px: Floats32, disparity_px: float, n_views: int, rng: np.random.Generator
) -> list[Sample]:
    """Up to ``n_views`` of an image: the first mirrored, the others enlarged parts.

    image, map_px: (height, width); the map is NaN where unmatched. Labels beyond what a view
    shows are never made up: a part with too few matches is left out.
    """
    view = np.ascontiguousarray(gradients.shrink(image)[:, ::-1])
    mirrored = Sample(view, disparity_px, map_px[:, ::-1], 1.0)
    nearer = (_enlarged(image, map_px, rng) for _ in range(n_views - 1))
    return [mirrored, *(sample for sample in nearer if sample is not None)]


def _enlarged(image: Grey, map_px: Floats32, rng: np.random.Generator) -> Sample | None:
    height, width = image.shape
    zoom = MOST_ZOOM ** rng.random()
    crop_height, crop_width = round(height / zoom), round(width / zoom)
    top = rng.integers(0, height - crop_height + 1)
    left = rng.integers(0, width - crop_width + 1)
    part = np.s_[top : top + crop_height, left : left + crop_width]
    part_px = map_px[part]
    known_px = part_px[np.isfinite(part_px)]
    if known_px.size < LEAST_VALID_NORM * crop_height * crop_width:
        return None
    view = gradients.shrink(image[part])
    if rng.random() < 0.5:
        view, part_px = view[:, ::-1], part_px[:, ::-1]
    noise = rng.standard_normal(view.shape, dtype=np.float32) * np.float32(NOISE_LSB)
    zoom = width / crop_width
    return Sample(view + noise, float(known_px.mean()) * zoom, part_px, zoom)
