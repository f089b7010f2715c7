"""What an image is turned into before a regressor sees it; the kinds are chosen by name."""

from collections.abc import Callable, Mapping
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from companion.kernel.errors import PlanError
from companion.vision import gradients
from companion.vision.cells import COLUMNS, ROWS
from companion.vision.textons import TextonDictionary, TextonEncoder, TextonSettings, TextonTrainer

Kind = Literal["textons", "entropy", "gradients", "pixels"]
Grey = NDArray[np.uint8]
Floats32 = NDArray[np.float32]
Features = Floats32


def pixels_of(view: Floats32) -> Features:
    """A shrunk image itself, row by row: (gradients.HEIGHT_PX * gradients.WIDTH_PX,)."""
    return view.reshape(-1)


OF_VIEWS: Mapping[Kind, Callable[[Floats32], Features]] = {
    "gradients": gradients.encode,
    "pixels": pixels_of,
}
"""Kinds that are made of a shrunk image, and so of companion.vision.views' enlarged ones too."""


class Extractor(Protocol):
    """Images to feature vectors of one length."""

    @property
    def dictionary(self) -> TextonDictionary | None:
        """The textons, where there are any yet."""
        ...

    @property
    def ready(self) -> bool:
        """True when images become features."""
        ...

    def observe(self, image: Grey, frozen: bool) -> Features | None:
        """Features of an image (height, width); None while it can only be learned from."""
        ...

    def cells(self, image: Grey) -> Features:
        """Features of each cell of an image alone, (CELLS, n). It must be ready."""
        ...

    def adopt(self, dictionary: TextonDictionary) -> None:
        """Uses these textons from here on. Raises PlanError where they do not fit."""
        ...


class ViewFeatures:
    """Of the shrunk image, by the kinds in OF_VIEWS: nothing is learned, it is ready at once."""

    dictionary = None
    ready = True

    def __init__(self, kind: Kind) -> None:
        self._kind = kind

    def observe(self, image: Grey, frozen: bool) -> Features | None:
        return OF_VIEWS[self._kind](gradients.shrink(image))

    def cells(self, image: Grey) -> Features:
        return gradients.encode_cells(gradients.shrink(image))

    def adopt(self, dictionary: TextonDictionary) -> None:
        raise PlanError(f'learner.dictionary: features "{self._kind}" use no textons')


class TextonFeatures:
    """See textons.py: learns its dictionary from the first images, unless given one."""

    def __init__(
        self, settings: TextonSettings, entropy_scale: float, rng: np.random.Generator
    ) -> None:
        self._settings = settings
        self._entropy_scale = entropy_scale
        training_rng, self._sampling_rng = rng.spawn(2)
        self._trainer = TextonTrainer(settings, training_rng)
        self._encoder: TextonEncoder | None = None

    @property
    def ready(self) -> bool:
        return self._encoder is not None

    @property
    def dictionary(self) -> TextonDictionary | None:
        return self._encoder.dictionary if self._encoder else None

    def observe(self, image: Grey, frozen: bool) -> Features | None:
        if self._encoder is not None:
            return self._encoder.encode(image)
        if not frozen:
            self._trainer.update(image)
            if self._trainer.finished:
                self.adopt(self._trainer.dictionary)
        return None

    def cells(self, image: Grey) -> Features:
        if self._encoder is None:
            raise RuntimeError("cells need a dictionary")
        return self._encoder.encode_cells(image, ROWS, COLUMNS)

    def adopt(self, dictionary: TextonDictionary) -> None:
        textons = self._settings
        n_values = textons.patch_px**2
        wanted = (textons.intensity, n_values), (textons.gradient, n_values)
        found = dictionary.intensity.shape, dictionary.gradient.shape
        if found != wanted:
            raise PlanError(
                f"dictionary has textons of shape {found[0]} and {found[1]}; "
                f"the settings ask for {wanted[0]} and {wanted[1]}"
            )
        self._encoder = TextonEncoder(dictionary, textons, self._sampling_rng, self._entropy_scale)


class EntropyFeatures(TextonFeatures):
    """The entropy of the texton histogram alone: the appearance variation cue (de Croon 2012)."""

    def observe(self, image: Grey, frozen: bool) -> Features | None:
        features = super().observe(image, frozen)
        return None if features is None else features[-1:]
