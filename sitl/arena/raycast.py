"""Rays against rooms: which surface every pixel sees, and how far away it is.

A ray is (x, y, 1) in CAM, so its parameter at a hit is the depth along the optical axis. Pixels are
worked on in square tiles, one short loop after the other over all pixels of a tile: the compiler
turns such loops into vector instructions, and looks up each object once per tile.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.arena.atlas import CYLINDER_FACES, FACES, Atlas
from sitl.arena.jit import kernel
from sitl.arena.room import Room

TILE_PX = 16
PIXELS = TILE_PX * TILE_PX
NEAREST_M = 1e-3
TINY = 1e-9

Floats = NDArray[np.float32]
Whole = NDArray[np.int32]


class Scene(NamedTuple):
    """A painted room; geometry as in ``Room``, texels as in ``Atlas``, all single precision.

    blocks: (1 + boxes, 6), the room first. spheres: (boxes then cylinders, 4), centre and radius of
    a ball around each object. rows: (surface, level, 2), start and stride. frame: (surface, 4),
    origin and size along u and v. axis: (surface,).
    """

    blocks: Floats
    cylinders: Floats
    spheres: Floats
    texel_m: np.float32
    texels: NDArray[np.uint8]
    rows: Whole
    scale: Floats
    frame: Floats
    axis: Whole


class Eye(NamedTuple):
    """What is fixed about one eye.

    rays: (tile, 2, PIXELS), x and y at depth 1 of each pixel's ray, tiles row by row. cones:
    (tile, 5), axis in CAM, cosine and sine of half the opening angle of a cone around each tile.
    """

    height_px: int
    width_px: int
    rays: Floats
    cones: Floats
    pixel_rad: np.float32


class Pose(NamedTuple):
    """position: (3,) NED of the room; ned_from_cam: (3, 3)."""

    position: Floats
    ned_from_cam: Floats


class Tile(NamedTuple):
    """Scratch for one tile; every array has one value per pixel."""

    dx: Floats
    dy: Floats
    dz: Floats
    depth: Floats
    surface: Whole


def build_scene(room: Room, atlas: Atlas) -> Scene:
    centres = [(box[:3] + box[3:]) / 2 for box in room.boxes_ned_m]
    radii = [float(np.linalg.norm(box[3:] - box[:3])) / 2 for box in room.boxes_ned_m]
    for north, east, radius, top, foot in room.cylinders_ned_m:
        centres.append(np.array([north, east, (top + foot) / 2]))
        radii.append(math.hypot(radius, (foot - top) / 2))
    spheres = [(*centre, radius) for centre, radius in zip(centres, radii, strict=True)]
    blocks = np.concatenate([room.bounds_ned_m.reshape(1, 6), room.boxes_ned_m])
    return Scene(
        blocks=blocks.astype(np.float32),
        cylinders=room.cylinders_ned_m.astype(np.float32),
        spheres=np.array(spheres, np.float32).reshape(-1, 4),
        texel_m=np.float32(room.settings.texel_m),
        texels=atlas.texels,
        rows=np.stack([atlas.start, atlas.stride], axis=-1),
        scale=atlas.scale,
        frame=np.concatenate([atlas.origin_m, atlas.size_m], axis=1),
        axis=atlas.axis,
    )


def build_eye(rays: Floats, focal_px: float) -> Eye:
    """``rays``: (height, width, 2), x and y of each pixel's ray at depth 1."""
    height, width = rays.shape[:2]
    filled = np.pad(rays, ((0, -height % TILE_PX), (0, -width % TILE_PX), (0, 0)), mode="edge")
    split = filled.reshape(filled.shape[0] // TILE_PX, TILE_PX, -1, TILE_PX, 2)
    tiles = split.transpose(0, 2, 4, 1, 3).reshape(-1, 2, PIXELS)
    directions = np.concatenate([tiles, np.ones_like(tiles[:, :1])], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    axes = directions.mean(axis=2)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    # Rounding must not let an object slip off the rim of a cone.
    cosines = np.clip((directions * axes[:, :, None]).sum(axis=1).min(axis=1) - 1e-5, -1.0, 1.0)
    cones = np.column_stack([axes, cosines, np.sqrt(1.0 - cosines**2)]).astype(np.float32)
    return Eye(height, width, np.ascontiguousarray(tiles), cones, np.float32(1.0 / focal_px))


@kernel
def new_tile() -> Tile:
    floats = np.empty((4, PIXELS), np.float32)
    return Tile(floats[0], floats[1], floats[2], floats[3], np.empty(PIXELS, np.int32))


@kernel
def hit_tile(scene: Scene, eye: Eye, index: int, pose: Pose, found: Whole, tile: Tile) -> None:
    """Fills ``tile`` with what the rays of the eye's tile ``index`` meet first."""
    position = pose.position
    _aim(eye.rays[index], pose.ned_from_cam[0], tile.dx)
    _aim(eye.rays[index], pose.ned_from_cam[1], tile.dy)
    _aim(eye.rays[index], pose.ned_from_cam[2], tile.dz)
    _hit_room(scene.blocks[0], position, tile)
    count = _near_objects(scene.spheres, eye.cones[index], pose, found)
    boxes = scene.blocks.shape[0] - 1
    for index in found[:count]:
        if index < boxes:
            _hit_box(scene.blocks, index + 1, position, tile)
        else:
            first_surface = FACES * (boxes + 1) + CYLINDER_FACES * (index - boxes)
            _hit_cylinder(scene.cylinders[index - boxes], first_surface, position, tile)


@kernel
def _aim(rays: Floats, row: Floats, component: Floats) -> None:
    """One NED component of every ray's direction; never 0, so that no quotient is 0 / 0."""
    x, y = rays[0], rays[1]
    a, b, c = row[0], row[1], row[2]
    tiny = np.float32(TINY)
    for p in range(PIXELS):
        value = a * x[p] + b * y[p] + c
        component[p] = value if abs(value) > tiny else tiny


@kernel
def _near_objects(spheres: Floats, cone: Floats, pose: Pose, found: Whole) -> int:
    """Writes the objects whose ball touches the tile's cone into ``found``; returns how many."""
    position, r = pose.position, pose.ned_from_cam
    a = r[0, 0] * cone[0] + r[0, 1] * cone[1] + r[0, 2] * cone[2]
    b = r[1, 0] * cone[0] + r[1, 1] * cone[1] + r[1, 2] * cone[2]
    c = r[2, 0] * cone[0] + r[2, 1] * cone[1] + r[2, 2] * cone[2]
    count = 0
    for index in range(spheres.shape[0]):
        x, y = spheres[index, 0] - position[0], spheres[index, 1] - position[1]
        z, radius = spheres[index, 2] - position[2], spheres[index, 3]
        tangent_square = x * x + y * y + z * z - radius * radius
        if tangent_square > 0:
            reach = cone[3] * math.sqrt(tangent_square) - cone[4] * radius
            if a * x + b * y + c * z < reach:
                continue
        found[count] = index
        count += 1
    return count


@kernel
def _hit_room(bounds: Floats, position: Floats, tile: Tile) -> None:
    """Where each ray leaves the room."""
    dx, dy, dz, depth, surface = tile.dx, tile.dy, tile.dz, tile.depth, tile.surface
    north, south = bounds[3] - position[0], bounds[0] - position[0]
    east, west = bounds[4] - position[1], bounds[1] - position[1]
    floor, ceiling = bounds[5] - position[2], bounds[2] - position[2]
    nearest = np.float32(NEAREST_M)
    for p in range(PIXELS):
        x = (north if dx[p] > 0 else south) / dx[p]
        y = (east if dy[p] > 0 else west) / dy[p]
        z = (floor if dz[p] > 0 else ceiling) / dz[p]
        first = min(x, min(y, z))
        side_x, side_y, side_z = 0 if dx[p] > 0 else 2, 1 if dy[p] > 0 else 3, 4 if dz[p] > 0 else 5
        depth[p] = max(first, nearest)
        surface[p] = side_x if x == first else (side_y if y == first else side_z)


@kernel
def _hit_box(blocks: Floats, index: int, position: Floats, tile: Tile) -> None:
    """Overwrites what is farther than the box; a box is not seen from inside."""
    dx, dy, dz, depth, surface = tile.dx, tile.dy, tile.dz, tile.depth, tile.surface
    south, north = blocks[index, 0] - position[0], blocks[index, 3] - position[0]
    west, east = blocks[index, 1] - position[1], blocks[index, 4] - position[1]
    top, bottom = blocks[index, 2] - position[2], blocks[index, 5] - position[2]
    first_surface, nearest = FACES * index, np.float32(NEAREST_M)
    for p in range(PIXELS):
        x = (south if dx[p] > 0 else north) / dx[p]
        y = (west if dy[p] > 0 else east) / dy[p]
        z = (top if dz[p] > 0 else bottom) / dz[p]
        leave_x = (north if dx[p] > 0 else south) / dx[p]
        leave_y = (east if dy[p] > 0 else west) / dy[p]
        leave_z = (bottom if dz[p] > 0 else top) / dz[p]
        first, last = max(x, max(y, z)), min(leave_x, min(leave_y, leave_z))
        hit = (first < last) & (first > nearest) & (first < depth[p])
        side_x, side_y, side_z = 2 if dx[p] > 0 else 0, 3 if dy[p] > 0 else 1, 5 if dz[p] > 0 else 4
        side = side_x if x == first else (side_y if y == first else side_z)
        depth[p] = first if hit else depth[p]
        surface[p] = first_surface + side if hit else surface[p]


@kernel
def _hit_cylinder(cylinder: Floats, first_surface: int, position: Floats, tile: Tile) -> None:
    """Overwrites what is farther than the cylinder: bottom, top, then mantle."""
    dx, dy, dz, depth, surface = tile.dx, tile.dy, tile.dz, tile.depth, tile.surface
    x, y, radius = position[0] - cylinder[0], position[1] - cylinder[1], cylinder[2]
    top_down, foot_down = cylinder[3] - position[2], cylinder[4] - position[2]
    rest = x * x + y * y - radius * radius
    zero, nearest = np.float32(0.0), np.float32(NEAREST_M)
    for p in range(PIXELS):
        a = dx[p] * dx[p] + dy[p] * dy[p]
        b = x * dx[p] + y * dy[p]
        square = b * b - a * rest
        root = math.sqrt(max(square, zero))
        enter, leave = (-b - root) / a, (root - b) / a
        top, foot = top_down / dz[p], foot_down / dz[p]
        first, last = max(enter, min(top, foot)), min(leave, max(top, foot))
        hit = (square > zero) & (first < last) & (first > nearest) & (first < depth[p])
        part = 2 if first == enter else (1 if top < foot else 0)
        depth[p] = first if hit else depth[p]
        surface[p] = first_surface + part if hit else surface[p]


@kernel
def render_depth(scene: Scene, eye: Eye, pose: Pose, depth_m: Floats) -> None:
    """Writes the depth of every pixel into ``depth_m``, float32 (height, width)."""
    tile = new_tile()
    found = np.empty(scene.spheres.shape[0] + 1, np.int32)
    columns = -(-eye.width_px // TILE_PX)
    for index in range(eye.rays.shape[0]):
        hit_tile(scene, eye, index, pose, found, tile)
        top, left = index // columns * TILE_PX, index % columns * TILE_PX
        for row in range(top, min(top + TILE_PX, eye.height_px)):
            for column in range(left, min(left + TILE_PX, eye.width_px)):
                depth_m[row, column] = tile.depth[(row - top) * TILE_PX + column - left]
