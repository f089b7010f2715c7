"""Textures by name: a pattern from a seed, a PNG, or a photograph that scikit-image ships."""

import importlib.util
import math
from collections.abc import Callable
from os.path import isfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.errors import PlanError
from sitl.arena import patterns, pictures
from sitl.arena.paint import Image, Sheet, mirrored

PHOTO = "photo:"

PATTERNS: dict[str, Callable[[Sheet, np.random.Generator], Image]] = {
    "banner": pictures.banner,
    "bookshelf": pictures.bookshelf,
    "brick": patterns.brick,
    "cardboard": patterns.cardboard,
    "carpet": patterns.carpet,
    "carpet_tiles": patterns.carpet_tiles,
    "concrete": patterns.concrete,
    "door": pictures.door,
    "noise": patterns.rough,
    "paint": patterns.paint,
    "plywood": patterns.plywood,
    "plywood_tape": patterns.plywood_tape,
    "poster": pictures.poster,
    "wallpaper": patterns.wallpaper,
    "window": pictures.window,
    "wood": patterns.wood,
}


def check_texture(texture: str, key: str, folder: Path) -> None:
    """Raises PlanError, naming ``key``, unless ``texture`` can be painted."""
    if texture in PATTERNS:
        return
    if texture.startswith(PHOTO) or is_picture_file(texture):
        _picture_path(texture, key, folder)
        return
    allowed = ", ".join(sorted(PATTERNS))
    raise PlanError(f"{key}: no texture {texture!r}; allowed: {allowed}, a .png file, photo:NAME")


def is_picture_file(texture: str) -> bool:
    """Whether it names a file beside the room's, rather than a pattern or a photograph."""
    return not texture.startswith(PHOTO) and texture.lower().endswith(".png")


def paint_texture(
    texture: str, sheet: Sheet, rng: np.random.Generator, folder: Path, repeat_m: float | None
) -> Image:
    """Reflectance of the whole sheet, clipped to 0.02-0.98: nothing is quite black or white.

    Raises PlanError for a picture that is not there or cannot be read.
    """
    if texture in PATTERNS:
        image = PATTERNS[texture](sheet, rng)
    else:
        image = _picture(_picture_path(texture, "texture", folder), sheet, repeat_m)
    return np.clip(image, 0.02, 0.98, out=image)


def _picture_path(texture: str, key: str, folder: Path) -> Path:
    if not texture.startswith(PHOTO):
        path = folder / texture
        if not isfile(path):
            raise PlanError(f"{key}: no picture {path}")
        return path
    name = texture.removeprefix(PHOTO)
    spec = importlib.util.find_spec("skimage")
    if spec is None or spec.origin is None:
        raise PlanError(f"{key}: {texture!r} needs scikit-image; pip install scikit-image")
    photos = Path(spec.origin).parent / "data"
    path = photos / f"{name}.png"
    if not isfile(path):
        allowed = ", ".join(sorted(photo.stem for photo in photos.glob("*.png")))
        raise PlanError(f"{key}: scikit-image ships no photograph {name!r}; allowed: {allowed}")
    return path


def _picture(path: Path, sheet: Sheet, repeat_m: float | None) -> Image:
    """The file in grey: stretched over the sheet, or in mirrored copies ``repeat_m`` wide."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise PlanError(f"{path}: not a picture that OpenCV can read")
    if repeat_m is None:
        return _resize(grey, sheet.rows, sheet.columns)
    columns = max(1, round(repeat_m / sheet.texel_m))
    rows = max(1, math.ceil(columns * grey.shape[0] / grey.shape[1]))
    return mirrored(_resize(grey, rows, columns), sheet.rows, sheet.columns)


def _resize(grey: NDArray[Any], rows: int, columns: int) -> Image:
    shrinks = rows < grey.shape[0] and columns < grey.shape[1]
    how = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    image = cv2.resize(grey.astype(np.float32) / 255, (columns, rows), interpolation=how)
    return np.asarray(image, np.float32)
