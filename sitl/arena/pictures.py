"""Things that hang on walls: posters, windows, doors, shelves; painted to the size they have."""

import math

import numpy as np

from sitl.arena.paint import Image, Sheet, disc, noise, polygon, rectangle, strip

FINE_M = 0.05


def poster(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Printed art: a shaded ground, a dozen big shapes, lines of text, a white margin."""
    image = rng.uniform(0.25, 0.65) + 0.10 * noise(sheet, rng, sheet.height_m, 0.02)
    scale_m = min(sheet.width_m, sheet.height_m)
    for _ in range(12):
        tone, size_m = rng.uniform(0.05, 0.95), scale_m * rng.uniform(0.06, 0.3)
        centre_m = sheet.point_m(rng)
        if rng.random() < 0.5:
            disc(image, sheet, centre_m, size_m / 2, tone)
        else:
            angle_rad = rng.uniform(0, math.pi)
            strip(image, sheet, centre_m, (1.8 * size_m, size_m), angle_rad, tone)
    image += 0.05 * noise(sheet, rng, 0.2)
    _text(image, sheet, rng, 0.78 * sheet.height_m)
    _margin(image, sheet, 0.03 * scale_m, 0.88)
    return image


def _text(image: Image, sheet: Sheet, rng: np.random.Generator, top_m: float) -> None:
    """Three lines of words on a band of paper."""
    line_m = 0.055 * sheet.height_m
    rectangle(image, sheet, (0.0, top_m), (sheet.width_m, 3.6 * line_m), 0.85)
    for line in range(3):
        u, v = 0.1 * sheet.width_m, top_m + (0.4 + line) * line_m
        while u < 0.85 * sheet.width_m:
            word_m = rng.uniform(0.5, 3.0) * line_m
            rectangle(image, sheet, (u, v), (word_m, 0.6 * line_m), 0.15)
            u += word_m + 0.5 * line_m


def _margin(image: Image, sheet: Sheet, margin_m: float, tone: float) -> None:
    rim = max(1, round(margin_m / sheet.texel_m))
    image[:rim] = image[-rim:] = tone
    image[:, :rim] = image[:, -rim:] = tone


def window(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Four panes with a view: bright sky with clouds, a dark line of trees and houses."""
    image = 0.86 + 0.05 * noise(sheet, rng, sheet.width_m, 0.1)
    skyline_m = 0.62 * sheet.height_m
    trees = 0.30 + 0.09 * noise(sheet, rng, 0.3)
    edge = skyline_m / sheet.texel_m + 0.05 / sheet.texel_m * noise(sheet, rng, 0.6)[0]
    below = np.arange(sheet.rows)[:, None] > edge[None, :]
    image[below] = trees[below]
    for _ in range(4):
        width_m = rng.uniform(0.08, 0.2) * sheet.width_m
        top_m = skyline_m - rng.uniform(0.05, 0.25) * sheet.height_m
        left_m = rng.uniform(0, sheet.width_m - width_m)
        size_m = (width_m, sheet.height_m - top_m)
        rectangle(image, sheet, (left_m, top_m), size_m, rng.uniform(0.35, 0.65))
    bar_m, tone = 0.05, 0.78
    for u in (0.0, (sheet.width_m - bar_m) / 2, sheet.width_m - bar_m):
        rectangle(image, sheet, (u, 0.0), (bar_m, sheet.height_m), tone)
        rectangle(image, sheet, (u + bar_m, 0.0), (0.008, sheet.height_m), 0.3)
    for v in (0.0, (sheet.height_m - bar_m) / 2, sheet.height_m - bar_m):
        rectangle(image, sheet, (0.0, v), (sheet.width_m, bar_m), tone)
        rectangle(image, sheet, (0.0, v + bar_m), (sheet.width_m, 0.008), 0.3)
    image += 0.012 * noise(sheet, rng, FINE_M)
    return image


def door(sheet: Sheet, rng: np.random.Generator) -> Image:
    """A panelled door in its frame, with handle, lock, nameplate and kicks at the foot."""
    image = 0.34 + 0.025 * noise(sheet, rng, 0.08, stretch=8.0)
    image += 0.02 * noise(sheet, rng, FINE_M)
    _margin(image, sheet, 0.07, 0.7)
    width_m, height_m = sheet.width_m, sheet.height_m
    for v, panel_m in ((0.10 * height_m, 0.30 * height_m), (0.55 * height_m, 0.36 * height_m)):
        for u in (0.17 * width_m, 0.54 * width_m):
            rectangle(image, sheet, (u, v), (0.29 * width_m, panel_m), 0.22)
            inner_m = (0.29 * width_m - 0.024, panel_m - 0.024)
            rectangle(image, sheet, (u + 0.012, v + 0.012), inner_m, 0.38)
    strip(image, sheet, (0.86 * width_m, 0.49 * height_m), (0.13, 0.025), 0.0, 0.85)
    disc(image, sheet, (0.88 * width_m, 0.53 * height_m), 0.015, 0.8)
    rectangle(image, sheet, (0.38 * width_m, 0.04 * height_m), (0.24 * width_m, 0.05), 0.85)
    for _ in range(8):
        kick_m = (rng.uniform(0.1, 0.9) * width_m, rng.uniform(0.92, 0.96) * height_m)
        strip(image, sheet, kick_m, (rng.uniform(0.03, 0.15), 0.012), rng.normal(0, 0.4), 0.15)
    image += 0.02 * noise(sheet, rng, 0.3)
    return image


def bookshelf(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Boards every 0.33 m and spines of many widths, tones and heights between them."""
    image = sheet.filled(0.08)
    for foot_m in np.arange(0.33, sheet.height_m + 0.33, 0.33):
        u = 0.02
        while u < sheet.width_m - 0.02:
            spine_m = (rng.uniform(0.015, 0.06), rng.uniform(0.18, 0.29))
            tone = rng.uniform(0.12, 0.85)
            rectangle(image, sheet, (u, foot_m - spine_m[1]), spine_m, tone)
            label_m = (spine_m[0] * 0.6, 0.05)
            label_at_m = (u + 0.2 * spine_m[0], foot_m - 0.8 * spine_m[1])
            rectangle(image, sheet, label_at_m, label_m, 0.9 - 0.8 * (tone > 0.5))
            u += spine_m[0] + (0.003 if rng.random() < 0.9 else rng.uniform(0.03, 0.15))
        rectangle(image, sheet, (0.0, foot_m), (sheet.width_m, 0.025), 0.5)
    image += 0.02 * noise(sheet, rng, FINE_M)
    return image


def banner(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Slanted stripes in a few tones, 0.1-0.4 m wide."""
    image = sheet.filled(0.5)
    lean_m = 0.4 * sheet.height_m
    u = -lean_m
    while u < sheet.width_m:
        width_m = rng.uniform(0.1, 0.4)
        top = [(u + lean_m, 0.0), (u + lean_m + width_m, 0.0)]
        foot = [(u + width_m, sheet.height_m), (u, sheet.height_m)]
        polygon(image, sheet, np.array(top + foot), rng.uniform(0.1, 0.9))
        u += width_m
    image += 0.03 * noise(sheet, rng, 0.2)
    return image
