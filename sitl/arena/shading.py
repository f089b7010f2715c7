"""What pixels look like: the texels under each pixel's footprint, averaged.

The level of the pyramid follows the narrow side of the footprint on the surface; up to TAPS samples
lie along its wide side. So texture fades with distance and slant as it does through a lens, and
nothing flickers.
"""

import math
from typing import NamedTuple

import numpy as np

from sitl.arena.atlas import CYLINDER_FACES, FACES, FULL_SCALE, LEVELS, MANTLE
from sitl.arena.jit import kernel
from sitl.arena.raycast import (
    PIXELS,
    TILE_PX,
    Eye,
    Floats,
    Pose,
    Scene,
    Tile,
    Whole,
    hit_tile,
    new_tile,
)

TAPS = 4
TEXELS_PER_PIXEL = math.sqrt(2.0)
"""Averaging over such texels and interpolating between them blurs about as one pixel does."""


class Footprints(NamedTuple):
    """Scratch for one tile: middle, step over the wide side (metres along u and v), level, taps."""

    u: Floats
    v: Floats
    step_u: Floats
    step_v: Floats
    level: Whole
    taps: Whole


@kernel
def render(scene: Scene, eye: Eye, pose: Pose, weight: np.float32, radiance: Floats) -> None:
    """Adds ``weight`` times the image from this pose to ``radiance``, float32 (height, width)."""
    tile = new_tile()
    floats, whole = np.empty((4, PIXELS), np.float32), np.empty((2, PIXELS), np.int32)
    prints = Footprints(floats[0], floats[1], floats[2], floats[3], whole[0], whole[1])
    found = np.empty(scene.spheres.shape[0] + 1, np.int32)
    columns = -(-eye.width_px // TILE_PX)
    for index in range(eye.rays.shape[0]):
        hit_tile(scene, eye, index, pose, found, tile)
        _lay_on_faces(scene, pose, eye.pixel_rad, tile, prints)
        if scene.cylinders.shape[0] > 0:
            _lay_on_mantles(scene, pose, eye.pixel_rad, tile, prints)
        top, left = index // columns * TILE_PX, index % columns * TILE_PX
        window = radiance[top : top + TILE_PX, left : left + TILE_PX]
        _sample(scene, tile.surface, prints, weight, window)


@kernel
def _lay_on_faces(
    scene: Scene, pose: Pose, pixel_rad: np.float32, tile: Tile, prints: Footprints
) -> None:
    """Where each pixel's footprint lies on its flat surface, how it stretches, what it reads.

    One pixel to the right or down turns the ray by a column of ned_from_cam times the size of a
    pixel; the hit then slides along the ray so that it stays in the plane.
    """
    dx, dy, dz, depth = tile.dx, tile.dy, tile.dz, tile.depth
    o, r, axes = pose.position, pose.ned_from_cam, scene.axis
    for p in range(PIXELS):
        axis = axes[np.uint32(tile.surface[p])]
        x, y, z = o[0] + depth[p] * dx[p], o[1] + depth[p] * dy[p], o[2] + depth[p] * dz[p]
        span = depth[p] * pixel_rad
        level, north = axis == 2, axis == 0
        prints.u[p], prints.v[p] = y if north else x, y if level else z
        along_u, along_v = dy[p] if north else dx[p], dy[p] if level else dz[p]
        slide = span / (dz[p] if level else (dx[p] if north else dy[p]))
        right = slide * (r[2, 0] if level else (r[0, 0] if north else r[1, 0]))
        down = slide * (r[2, 1] if level else (r[0, 1] if north else r[1, 1]))
        right_u = span * (r[1, 0] if north else r[0, 0]) - along_u * right
        right_v = span * (r[1, 0] if level else r[2, 0]) - along_v * right
        down_u = span * (r[1, 1] if north else r[0, 1]) - along_u * down
        down_v = span * (r[1, 1] if level else r[2, 1]) - along_v * down
        prints.step_u[p], prints.step_v[p], prints.level[p], prints.taps[p] = _measure(
            right_u, right_v, down_u, down_v, scene.texel_m
        )


@kernel
def _lay_on_mantles(
    scene: Scene, pose: Pose, pixel_rad: np.float32, tile: Tile, prints: Footprints
) -> None:
    """The same where cylinders are seen, with the plane that touches them at the hit."""
    dx, dy, dz, depth = tile.dx, tile.dy, tile.dz, tile.depth
    o, r, cylinders = pose.position, pose.ned_from_cam, scene.cylinders
    first_surface = FACES * scene.blocks.shape[0]
    turn, grazing = np.float32(2.0 * math.pi), np.float32(-1e-3)
    for p in range(PIXELS):
        if scene.axis[np.uint32(tile.surface[p])] != MANTLE:
            continue
        index = np.uint32((tile.surface[p] - first_surface) // CYLINDER_FACES)
        radius, span = cylinders[index, 2], depth[p] * pixel_rad
        north = (o[0] + depth[p] * dx[p] - cylinders[index, 0]) / radius
        east = (o[1] + depth[p] * dy[p] - cylinders[index, 1]) / radius
        angle = np.float32(math.atan2(east, north))
        prints.u[p] = radius * (angle if angle >= 0 else angle + turn)
        prints.v[p] = o[2] + depth[p] * dz[p]
        along_u = north * dy[p] - east * dx[p]
        slide = span / min(north * dx[p] + east * dy[p], grazing)
        right = slide * (north * r[0, 0] + east * r[1, 0])
        down = slide * (north * r[0, 1] + east * r[1, 1])
        right_u = span * (north * r[1, 0] - east * r[0, 0]) - along_u * right
        down_u = span * (north * r[1, 1] - east * r[0, 1]) - along_u * down
        right_v, down_v = span * r[2, 0] - dz[p] * right, span * r[2, 1] - dz[p] * down
        prints.step_u[p], prints.step_v[p], prints.level[p], prints.taps[p] = _measure(
            right_u, right_v, down_u, down_v, scene.texel_m
        )


@kernel
def _measure(
    right_u: np.float32,
    right_v: np.float32,
    down_u: np.float32,
    down_v: np.float32,
    texel_m: np.float32,
) -> tuple[np.float32, np.float32, np.int32, np.int32]:
    """(step_u, step_v, level, taps) of the footprint that one pixel right and one down span."""
    right, down = right_u * right_u + right_v * right_v, down_u * down_u + down_v * down_v
    area = right_u * down_v - right_v * down_u
    wide = np.maximum(right, down)
    narrow = np.maximum(area * area / wide, wide * np.float32(1.0 / TAPS**2))
    taps = np.int32(np.sqrt(wide / narrow) + np.float32(0.5))
    # A single's exponent is its logarithm to base 2; of a square, that counts half octaves. The
    # square root of 2 rounds it to the nearest.
    finest = texel_m * texel_m * np.float32(TEXELS_PER_PIXEL**2 / math.sqrt(2.0))
    exponent = np.float32(narrow / finest).view(np.int32) >> np.int32(23)
    level = np.minimum(np.maximum(exponent - np.int32(127), np.int32(0)), np.int32(LEVELS - 1))
    if right > down:
        return right_u, right_v, level, taps
    return down_u, down_v, level, taps


@kernel
def _sample(
    scene: Scene, surface: Whole, prints: Footprints, weight: np.float32, window: Floats
) -> None:
    """Adds the mean of each footprint's taps to ``window``, interpolating between four texels.

    Indices are unsigned because signed ones are tested for Python's counting from the end.
    """
    texels, frame = scene.texels, scene.frame
    half, zero = np.float32(0.5), np.float32(0.0)
    for row in range(window.shape[0]):
        for column in range(window.shape[1]):
            p = np.uint32(row * TILE_PX + column)
            face, level, taps = np.uint32(surface[p]), np.uint32(prints.level[p]), prints.taps[p]
            start = np.uint32(scene.rows[face, level, 0])
            stride = np.uint32(scene.rows[face, level, 1])
            share, total = np.float32(1.0) / np.float32(taps), zero
            for tap in range(taps):
                shift = (np.float32(tap) + half) * share - half
                u = prints.u[p] - frame[face, 0] + shift * prints.step_u[p]
                v = prints.v[p] - frame[face, 1] + shift * prints.step_v[p]
                x = min(max(u, zero), frame[face, 2]) * scene.scale[face, level, 0] + half
                y = min(max(v, zero), frame[face, 3]) * scene.scale[face, level, 1] + half
                i, j = np.uint32(x), np.uint32(y)
                x, y = x - np.float32(i), y - np.float32(j)
                upper = start + j * stride + i
                lower = upper + stride
                a, b = np.float32(texels[upper]), np.float32(texels[upper + np.uint32(1)])
                c, d = np.float32(texels[lower]), np.float32(texels[lower + np.uint32(1)])
                a, c = a + x * (b - a), c + x * (d - c)
                total += a + y * (c - a)
            window[row, column] += weight * share * np.float32(FULL_SCALE / 255.0) * total
