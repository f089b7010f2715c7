"""What pixels look like: the texels under each pixel's footprint, averaged.

The level of the pyramid follows the narrow side of the footprint on the surface; up to TAPS samples
lie along its wide side. So texture fades with distance and slant as it does through a lens, and
nothing flickers.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from sitl.arena.atlas import CYLINDER_FACES, FACES, FULL_SCALE, LEVELS, MANTLE
from sitl.arena.raycast import JIT, PIXELS, TILE_PX, Floats, Whole, hit_tile, new_tile

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


@njit(**JIT)
def render(scene, eye, pose, weight, radiance):
    """Adds ``weight`` times the image from this pose to ``radiance``, float32 (height, width)."""
    tile = new_tile()
    floats, whole = np.empty((4, PIXELS), np.float32), np.empty((2, PIXELS), np.int32)
    prints = Footprints(floats[0], floats[1], floats[2], floats[3], whole[0], whole[1])
    found = np.empty(scene.spheres.shape[0] + 1, np.int32)
    columns = -(-eye.width_px // TILE_PX)
    for index in range(eye.rays.shape[0]):
        hit_tile(scene, eye, index, pose, found, tile)
        _lay_footprints(scene, pose, eye.pixel_rad, tile, prints)
        top, left = index // columns * TILE_PX, index % columns * TILE_PX
        window = radiance[top : top + TILE_PX, left : left + TILE_PX]
        _sample(scene, tile.surface, prints, weight, window)


@njit(**JIT)
def _lay_footprints(scene, pose, pixel_rad, tile, prints):
    """Where each pixel's footprint lies on its surface, how it stretches, what it reads.

    One pixel to the right or down moves the ray by a column of ned_from_cam times the span of a
    pixel, and its hit along the ray so that it stays in the plane.
    """
    dx, dy, dz, depth, surface = tile.dx, tile.dy, tile.dz, tile.depth, tile.surface
    u, v, step_u, step_v = prints.u, prints.v, prints.step_u, prints.step_v
    o, r, axes = pose.position, pose.ned_from_cam, scene.axis
    first_round = FACES * scene.blocks.shape[0]
    texel_square = np.float32(TEXELS_PER_PIXEL**2 / math.sqrt(2.0)) * scene.texel_m**2
    for p in range(PIXELS):
        axis = axes[np.uint32(surface[p])]
        x, y, z = o[0] + depth[p] * dx[p], o[1] + depth[p] * dy[p], o[2] + depth[p] * dz[p]
        span = depth[p] * pixel_rad
        if axis == MANTLE:
            k = np.uint32((surface[p] - first_round) // CYLINDER_FACES)
            radius = scene.cylinders[k, 2]
            n, e = (x - scene.cylinders[k, 0]) / radius, (y - scene.cylinders[k, 1]) / radius
            a, b = n * r[0, 0] + e * r[1, 0], n * r[0, 1] + e * r[1, 1]
            slide = span / (n * dx[p] + e * dy[p])
            along = n * dy[p] - e * dx[p]
            u0, u1 = n * r[1, 0] - e * r[0, 0], n * r[1, 1] - e * r[0, 1]
            across, v0, v1 = dz[p], r[2, 0], r[2, 1]
            angle = math.atan2(e, n)
            u[p], v[p] = np.float32(angle if angle > 0 else angle + 2 * math.pi) * radius, z
        else:
            flat, north = axis == 2, axis == 0
            a = r[2, 0] if flat else (r[0, 0] if north else r[1, 0])
            b = r[2, 1] if flat else (r[0, 1] if north else r[1, 1])
            slide = span / (dz[p] if flat else (dx[p] if north else dy[p]))
            along, across = dy[p] if north else dx[p], dy[p] if flat else dz[p]
            u0, u1 = r[1, 0] if north else r[0, 0], r[1, 1] if north else r[0, 1]
            v0, v1 = r[1, 0] if flat else r[2, 0], r[1, 1] if flat else r[2, 1]
            u[p], v[p] = y if north else x, y if flat else z
        right_u, right_v = u0 * span - along * a * slide, v0 * span - across * a * slide
        down_u, down_v = u1 * span - along * b * slide, v1 * span - across * b * slide
        right, down = right_u**2 + right_v**2, down_u**2 + down_v**2
        wide = max(right, down)
        step_u[p] = right_u if right > down else down_u
        step_v[p] = right_v if right > down else down_v
        area = right_u * down_v - right_v * down_u
        narrow = max(area * area / wide, wide * np.float32(1.0 / TAPS**2))
        prints.taps[p] = np.int32(math.sqrt(wide / narrow) + np.float32(0.5))
        # The exponent of a single is its logarithm: two per octave, as the square has it.
        exponent = np.float32(narrow / texel_square).view(np.int32) >> 23
        prints.level[p] = min(max(exponent - 127, 0), LEVELS - 1)


@njit(**JIT)
def _sample(scene, surface, prints, weight, window):
    """Adds the mean of each footprint's taps to ``window``, interpolating between four texels."""
    texels, frame = scene.texels, scene.frame
    half, zero = np.float32(0.5), np.float32(0.0)
    for row in range(window.shape[0]):
        for column in range(window.shape[1]):
            p = np.uint32(row * TILE_PX + column)
            face, level = np.uint32(surface[p]), np.uint32(prints.level[p])
            start = np.uint32(scene.rows[face, level, 0])
            stride = np.uint32(scene.rows[face, level, 1])
            scale_u, scale_v = scene.scale[face, level, 0], scene.scale[face, level, 1]
            low_u, low_v = prints.u[p] - frame[face, 0], prints.v[p] - frame[face, 1]
            taps = prints.taps[p]
            share = np.float32(1.0) / np.float32(taps)
            total = zero
            for tap in range(taps):
                shift = (np.float32(tap) + half) * share - half
                u, v = low_u + shift * prints.step_u[p], low_v + shift * prints.step_v[p]
                x = min(max(u, zero), frame[face, 2]) * scale_u + half
                y = min(max(v, zero), frame[face, 3]) * scale_v + half
                i, j = np.uint32(x), np.uint32(y)
                x, y = x - np.float32(i), y - np.float32(j)
                at = start + j * stride + i
                below = at + stride
                a, b = np.float32(texels[at]), np.float32(texels[at + np.uint32(1)])
                c, d = np.float32(texels[below]), np.float32(texels[below + np.uint32(1)])
                upper, lower = a + x * (b - a), c + x * (d - c)
                total += upper + y * (lower - upper)
            window[row, column] += weight * share * np.float32(FULL_SCALE / 255.0) * total
