"""Materials: what walls, floors and furniture are made of, painted from a seed.

Every pattern carries structure at 5-50 cm, which shows from afar, and grain at the size of a
texel, which only shows from near: that change is what an image tells about distance.
"""

import math

import numpy as np

from sitl.arena.paint import (
    Image,
    Sheet,
    disc,
    in_steps,
    mirrored,
    noise,
    rectangle,
    strip,
)

FINE_M = 0.06


def plywood(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Pale sheets 1.22 m wide with upright grain, knots, and screws along the seams."""
    image = sheet.filled(0.62)
    image += 0.030 * noise(sheet, rng, 0.10, stretch=8.0)
    image += 0.022 * noise(sheet, rng, 1.6, 0.2)
    image += 0.022 * noise(sheet, rng, FINE_M)
    for _ in range(round(2.0 * sheet.width_m * sheet.height_m)):
        disc(image, sheet, sheet.point_m(rng), rng.uniform(0.006, 0.022), rng.uniform(0.3, 0.5))
    for seam_m in np.arange(rng.uniform(0.2, 1.2), sheet.width_m, 1.22):
        rectangle(image, sheet, (seam_m, 0.0), (0.006, sheet.height_m), 0.25)
        for v in np.arange(0.15, sheet.height_m, 0.3):
            disc(image, sheet, (seam_m - 0.03, v), 0.005, 0.2)
            disc(image, sheet, (seam_m + 0.036, v), 0.005, 0.2)
    return image


def plywood_tape(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Plywood with strips of duct-tape, stuck on to give stereo vision something to match."""
    image = plywood(sheet, rng)
    cell_m = 0.5
    for v in np.arange(0.0, sheet.height_m, cell_m):
        for u in np.arange(0.0, sheet.width_m, cell_m):
            centre_m = (u + cell_m * rng.random(), v + cell_m * rng.random())
            size_m = (rng.uniform(0.12, 0.7), 0.05)
            lean_rad = rng.choice([0.0, 0.5, 0.5, -0.6]) * math.pi + rng.normal(0, 0.2)
            reflectance = rng.choice([0.12, 0.22, 0.34, 0.45, 0.85])
            strip(image, sheet, centre_m, size_m, lean_rad, reflectance)
    image += 0.012 * noise(sheet, rng, FINE_M)
    return image


def carpet(sheet: Sheet, rng: np.random.Generator) -> Image:
    """A woven carpet: mirrored ornaments in five tones inside a border, with a tufted pile."""
    rows, columns = -(-sheet.rows // 2), -(-sheet.columns // 2)
    quarter = Sheet(rows, columns, sheet.texel_m)
    ornament = noise(quarter, rng, 0.5, 0.08)
    levels = np.array([0.16, 0.46, 0.24, 0.6, 0.34], np.float32)
    image = mirrored(in_steps(ornament, levels), sheet.rows, sheet.columns)
    for inset_m, reflectance in ((0.0, 0.2), (0.03, 0.7), (0.06, 0.3), (0.16, 0.65)):
        _border(image, sheet, inset_m, reflectance)
    image *= 1.0 + 0.16 * noise(sheet, rng, 0.05)
    return image


def _border(image: Image, sheet: Sheet, inset_m: float, reflectance: float) -> None:
    """Paints a closed line 3 cm wide, ``inset_m`` from the edge."""
    near, far = round(inset_m / sheet.texel_m), round((inset_m + 0.03) / sheet.texel_m)
    lines = image[near : sheet.rows - near, near : sheet.columns - near]
    width = far - near
    lines[:width] = lines[-width:] = reflectance
    lines[:, :width] = lines[:, -width:] = reflectance


def carpet_tiles(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Office floor: half-metre tiles with the pile brushed in turns, each with its own wear."""
    image = sheet.filled(0.0)
    along = noise(sheet, rng, 0.08, stretch=4.0)
    tile = round(0.5 / sheet.texel_m)
    for i, row in enumerate(range(0, sheet.rows, tile)):
        for j, column in enumerate(range(0, sheet.columns, tile)):
            tone = (0.30 if (i + j) % 2 else 0.36) + rng.normal(0, 0.02)
            image[row : row + tile, column : column + tile] = tone
    image += 0.035 * along + 0.02 * noise(sheet, rng, 2.0, 0.3)
    return image


def wallpaper(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Mirrored damask ornaments, 0.44 m from one to the next, on paper that has faded."""
    motif = Sheet(round(0.3 / sheet.texel_m), round(0.22 / sheet.texel_m), sheet.texel_m)
    levels = np.array([0.48, 0.66, 0.58], np.float32)
    ornament = in_steps(noise(motif, rng, 0.4, 0.05), levels)
    image = mirrored(ornament, sheet.rows, sheet.columns)
    image += 0.030 * noise(sheet, rng, 1.6, 0.1)
    image += 0.022 * noise(sheet, rng, FINE_M)
    return image


def brick(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Stretcher bond: bricks of 21 x 6.5 cm in many tones, pale mortar."""
    image = sheet.filled(0.66)
    for course, v in enumerate(np.arange(0.0, sheet.height_m, 0.075)):
        for u in np.arange(-0.11 * (course % 2), sheet.width_m, 0.22):
            rectangle(image, sheet, (u, v), (0.21, 0.065), rng.normal(0.36, 0.06))
    image += 0.025 * noise(sheet, rng, 1.2, 0.15)
    image += 0.040 * noise(sheet, rng, FINE_M)
    return image


def paint(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Matt white paint from a roller, with scuffs and the shadow of old nails."""
    image = sheet.filled(0.72)
    image += 0.020 * noise(sheet, rng, 1.6, 0.15)
    image += 0.020 * noise(sheet, rng, 0.12)
    for _ in range(round(3.0 * sheet.width_m * sheet.height_m)):
        size_m = (rng.uniform(0.02, 0.2), rng.uniform(0.004, 0.012))
        tone = rng.uniform(0.45, 0.62)
        strip(image, sheet, sheet.point_m(rng), size_m, rng.uniform(0, math.pi), tone)
    return image


def concrete(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Poured floor: clouds, pores, and a joint every 1.5 m."""
    image = sheet.filled(0.5)
    image += 0.045 * noise(sheet, rng, 1.6, 0.1)
    image += 0.030 * noise(sheet, rng, FINE_M)
    for joint_m in np.arange(0.7, sheet.width_m, 1.5):
        rectangle(image, sheet, (joint_m, 0.0), (0.01, sheet.height_m), 0.25)
    for joint_m in np.arange(0.6, sheet.height_m, 1.5):
        rectangle(image, sheet, (0.0, joint_m), (sheet.width_m, 0.01), 0.25)
    return image


def wood(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Furniture and panelling: planks of 9-20 cm with growth rings."""
    rings = noise(sheet, rng, 0.10, 0.02, stretch=10.0)
    image: Image = 0.40 + 0.07 * np.sin(2.5 * rings).astype(np.float32)
    image += 0.025 * noise(sheet, rng, FINE_M)
    u = 0.0
    while u < sheet.width_m:
        plank_m = rng.uniform(0.09, 0.2)
        columns = slice(round(u / sheet.texel_m), round((u + plank_m) / sheet.texel_m))
        image[:, columns] += rng.normal(0, 0.05)
        rectangle(image, sheet, (u, 0.0), (0.004, sheet.height_m), 0.15)
        u += plank_m
    return image


def cardboard(sheet: Sheet, rng: np.random.Generator) -> Image:
    """A brown box: flutes, a strip of tape along the middle, a label."""
    image = 0.45 + 0.03 * noise(sheet, rng, 0.03, stretch=20.0)
    image += 0.03 * noise(sheet, rng, 0.4)
    middle_m = (sheet.width_m / 2, sheet.height_m / 2)
    strip(image, sheet, middle_m, (sheet.width_m, 0.05), 0.0, 0.6)
    label_m = (rng.uniform(0.05, 0.6) * sheet.width_m, rng.uniform(0.05, 0.6) * sheet.height_m)
    rectangle(image, sheet, label_m, (0.15, 0.1), 0.85)
    for line in range(6):
        line_m = (label_m[0] + 0.01, label_m[1] + 0.012 + 0.014 * line)
        rectangle(image, sheet, line_m, (rng.uniform(0.04, 0.13), 0.006), 0.2)
    return image


def rough(sheet: Sheet, rng: np.random.Generator) -> Image:
    """Nothing but 1/f noise, over all scales."""
    return 0.5 + 0.13 * noise(sheet, rng, 2.0)
