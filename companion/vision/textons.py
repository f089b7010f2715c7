"""Visual bag of words: an image to the histogram of its textons and their entropy (section III-D).

Intensity textons are raw patches; gradient textons are the horizontal differences inside a patch
(central, one-sided in its edge columns). The dictionary is a Kohonen map per kind, trained a few
patches at a time, so that it can be learned in flight.
"""

import math
from collections.abc import Iterator
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from companion.compiled import kernel
from companion.kernel.settings import Settings

Grey = NDArray[np.uint8]
Floats32 = NDArray[np.float32]

MID_GREY = 128.0
"""Patches are taken relative to it: smaller numbers, fewer rounding errors, same distances."""

PATCHES_PER_CELL = 25
"""Of a map: more than the image's 500 would give, for fewer say little of a cell's textons."""


class TextonSettings(Settings, frozen=True):
    """The dictionary and how it is used; defaults are Table I."""

    patch_px: Annotated[int, Meta(ge=3, le=15)] = 5
    patches: Annotated[int, Meta(ge=1, le=100_000)] = 500
    """Patches compared per image; a grid takes the nearest number that fills it evenly."""
    intensity: Annotated[int, Meta(ge=1, le=128)] = 10
    gradient: Annotated[int, Meta(ge=1, le=128)] = 10
    sampling: Literal["grid", "random"] = "grid"
    training_images: Annotated[int, Meta(ge=1, le=100_000)] = 50
    training_patches: Annotated[int, Meta(ge=1, le=100_000)] = 200
    """Patches per training image."""
    rate_start: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.3
    rate_end: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.02

    @property
    def n_features(self) -> int:
        return self.intensity + self.gradient + 1


class TextonDictionary(NamedTuple):
    """Cluster centres, grey levels (relative to MID_GREY) and grey levels per pixel.

    intensity: (n_intensity, patch_px**2); gradient: (n_gradient, patch_px**2).
    """

    intensity: Floats32
    gradient: Floats32


class TextonTrainer:
    """Learns a dictionary from patches at random places, one image at a time."""

    def __init__(self, settings: TextonSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._gradient_of = gradient_matrix(settings.patch_px)
        self._n_images = 0
        self._nodes: TextonDictionary | None = None

    @property
    def finished(self) -> bool:
        return self._n_images >= self._settings.training_images

    @property
    def dictionary(self) -> TextonDictionary:
        """As far as it was learned. At least one image must have been seen."""
        if self._nodes is None:
            raise RuntimeError("a dictionary needs at least one image")
        return TextonDictionary(self._nodes.intensity.copy(), self._nodes.gradient.copy())

    def update(self, image: Grey) -> None:
        """Moves the textons towards patches of ``image``, (height, width)."""
        settings = self._settings
        size = settings.patch_px
        places = _random_places(image, size, settings.training_patches, self._rng)
        patches = _extract(image, places, size)
        gradients = patches @ self._gradient_of.T
        if self._nodes is None:
            self._nodes = TextonDictionary(
                self._first_nodes(patches, settings.intensity),
                self._first_nodes(gradients, settings.gradient),
            )
        done_norm = self._n_images / settings.training_images
        step_norm = 1.0 / (settings.training_images * len(patches))
        for nodes, samples in zip(self._nodes, (patches, gradients), strict=True):
            _train(nodes, samples, done_norm, step_norm, settings.rate_start, settings.rate_end)
        self._n_images += 1

    def _first_nodes(self, samples: Floats32, n_nodes: int) -> Floats32:
        """Patches of the first image, sorted by mean: neighbours on the map begin alike."""
        chosen = samples[self._rng.integers(len(samples), size=n_nodes)]
        return np.ascontiguousarray(chosen[np.argsort(chosen.mean(axis=1), kind="stable")])


class TextonEncoder:
    """Turns images into feature vectors with a fixed dictionary."""

    def __init__(
        self,
        dictionary: TextonDictionary,
        settings: TextonSettings,
        rng: np.random.Generator,
        entropy_scale: float = 1.0,
    ) -> None:
        self.dictionary = dictionary
        self._settings = settings
        self._rng = rng
        self._entropy_scale = entropy_scale
        self._weights, self._offsets = _linear_form(dictionary, settings.patch_px)
        self._grid = np.empty((0, 2), dtype=np.int64)
        self._grid_shape: tuple[int, ...] = ()

    def encode(self, image: Grey) -> Floats32:
        """Features of an image: (n_features,), histogram (each half sums to 0.5), then entropy.

        Entropy is in bits over the whole histogram, times ``entropy_scale``.
        """
        features = np.empty(self._settings.n_features, dtype=np.float32)
        _encode(
            np.require(image, np.uint8, ("C", "W")),
            self._places(image),
            self._weights,
            self._offsets,
            self._settings.intensity,
            self._entropy_scale,
            features,
        )
        return features

    def encode_cells(self, image: Grey, rows: int, columns: int) -> Floats32:
        """Features of each of ``rows`` x ``columns`` cells alone: (n_cells, n_features)."""
        features = np.empty((rows * columns, self._settings.n_features), dtype=np.float32)
        image = np.require(image, np.uint8, ("C", "W"))
        for places, cell in zip(self._cell_places(image, rows, columns), features, strict=True):
            _encode(
                image,
                places,
                self._weights,
                self._offsets,
                self._settings.intensity,
                self._entropy_scale,
                cell,
            )
        return features

    def _cell_places(self, image: Grey, rows: int, columns: int) -> Iterator[NDArray[np.int64]]:
        """PATCHES_PER_CELL patches in each cell, row by row."""
        height, width = image.shape
        for row in range(rows):
            top, bottom = row * height // rows, (row + 1) * height // rows
            for column in range(columns):
                left, right = column * width // columns, (column + 1) * width // columns
                shape = bottom - top, right - left
                places = grid_places(shape, self._settings.patch_px, PATCHES_PER_CELL)
                yield places + np.array([top, left])

    def _places(self, image: Grey) -> NDArray[np.int64]:
        settings = self._settings
        if settings.sampling == "random":
            return _random_places(image, settings.patch_px, settings.patches, self._rng)
        if image.shape != self._grid_shape:
            self._grid = grid_places(image.shape, settings.patch_px, settings.patches)
            self._grid_shape = image.shape
        return self._grid


def grid_places(shape: tuple[int, ...], patch_px: int, patches: int) -> NDArray[np.int64]:
    """Top left corners (row, column) of about ``patches`` patches, evenly over the image."""
    last_row, last_column = shape[0] - patch_px, shape[1] - patch_px
    wanted = math.sqrt(patches * (last_column + 1) / (last_row + 1))
    n_columns = min(max(round(wanted), 1), last_column + 1)
    n_rows = min(max(round(patches / n_columns), 1), last_row + 1)
    rows = np.linspace(0, last_row, n_rows).round().astype(np.int64)
    columns = np.linspace(0, last_column, n_columns).round().astype(np.int64)
    return np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)


def gradient_matrix(patch_px: int) -> Floats32:
    """Turns a flat patch into its horizontal gradient: (patch_px**2, patch_px**2)."""
    along_row: NDArray[np.float64] = np.asarray(np.gradient(np.eye(patch_px), axis=1)).T
    return np.kron(np.eye(patch_px), along_row).astype(np.float32)


def _random_places(
    image: Grey, patch_px: int, patches: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    last = np.array(image.shape) - patch_px + 1
    return rng.integers(0, last, size=(patches, 2))


def _extract(image: Grey, places: NDArray[np.int64], patch_px: int) -> Floats32:
    """Flat patches relative to mid grey: (n_places, patch_px**2)."""
    windows = np.lib.stride_tricks.sliding_window_view(image, (patch_px, patch_px))
    patches = windows[places[:, 0], places[:, 1]].reshape(len(places), -1)
    return np.asarray(patches, dtype=np.float32) - np.float32(MID_GREY)


def _linear_form(dictionary: TextonDictionary, patch_px: int) -> tuple[Floats32, Floats32]:
    """Weights and offsets whose score ``offset + patch @ weights`` is least for the nearest texton.

    ``|p - t|^2 = |p|^2 - 2 p.t + |t|^2``, where the first term is the same for all textons; and a
    gradient is linear in its patch, so that it need not be computed. Weights: (patch_px**2,
    n_textons), offsets: (n_textons,).
    """
    gradient_of = gradient_matrix(patch_px).astype(np.float64)
    intensity = dictionary.intensity.astype(np.float64)
    gradient = dictionary.gradient.astype(np.float64)
    weights = -2.0 * np.concatenate([intensity, gradient @ gradient_of]).T
    offsets = np.concatenate([(intensity**2).sum(axis=1), (gradient**2).sum(axis=1)])
    return np.ascontiguousarray(weights, dtype=np.float32), offsets.astype(np.float32)


@kernel()
def _nearest(nodes: Floats32, sample: Floats32) -> int:
    best, winner = np.inf, 0
    for node in range(len(nodes)):
        distance = 0.0
        for value in range(len(sample)):
            distance += (nodes[node, value] - sample[value]) ** 2
        if distance < best:
            best, winner = distance, node
    return winner


# Signatures are given so that kernels are compiled, or read from the cache, before take-off.
@kernel("void(f4[:,::1], f4[:,::1], f8, f8, f8, f8)")
def _train(
    nodes: Floats32,
    samples: Floats32,
    done_norm: float,
    step_norm: float,
    rate_start: float,
    rate_end: float,
) -> None:
    """One Kohonen step per sample: the winner and its neighbours move towards it.

    Rate and neighbourhood (a Gaussian along the map) shrink geometrically with progress.
    """
    n_nodes, n_values = nodes.shape
    width_start = max(n_nodes / 4.0, 0.5)
    width_end = 0.2  # nodes: the nearest neighbour moves by less than 1e-5 of the winner
    for sample in samples:
        winner = _nearest(nodes, sample)
        rate = rate_start * (rate_end / rate_start) ** done_norm
        width = width_start * (width_end / width_start) ** done_norm
        for node in range(n_nodes):
            pull = rate * math.exp(-0.5 * ((node - winner) / width) ** 2)
            for value in range(n_values):
                nodes[node, value] += pull * (sample[value] - nodes[node, value])
        done_norm += step_norm


@kernel("void(u1[:,::1], i8[:,::1], f4[:,::1], f4[::1], i8, f8, f4[::1])", fast=True)
def _encode(
    image: Grey,
    places: NDArray[np.int64],
    weights: Floats32,
    offsets: Floats32,
    n_intensity: int,
    entropy_scale: float,
    features: Floats32,
) -> None:
    n_textons = len(offsets)
    size = round(math.sqrt(len(weights)))
    score = np.empty(n_textons, dtype=np.float32)
    features[:] = 0.0
    share = np.float32(0.5 / len(places))
    for place in range(len(places)):
        top, left = places[place]
        score[:] = offsets
        for row in range(size):
            for column in range(size):
                value = np.float32(image[top + row, left + column]) - np.float32(MID_GREY)
                weight = weights[row * size + column]
                for texton in range(n_textons):
                    score[texton] += value * weight[texton]
        features[np.argmin(score[:n_intensity])] += share
        features[n_intensity + np.argmin(score[n_intensity:])] += share
    entropy_bits = 0.0
    for texton in range(n_textons):
        if features[texton] > 0.0:
            entropy_bits -= features[texton] * math.log2(features[texton])
    features[n_textons] = entropy_bits * entropy_scale
