"""Textures: repeatable, all different, with the spectrum of natural scenes."""

import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.kernel.errors import PlanError
from sitl.arena.atlas import FULL_SCALE, LEVELS, build_atlas
from sitl.arena.paint import Sheet, mirrored, noise, rectangle
from sitl.arena.room import BoxSettings, RoomSettings, build_room
from sitl.arena.textures import PATTERNS, check_texture, paint_texture

SHEET = Sheet(256, 320, 0.004)
HERE = Path()


def paint(texture, seed=1, folder=HERE, repeat_m=None, sheet=SHEET):
    return paint_texture(texture, sheet, np.random.default_rng(seed), folder, repeat_m)


@pytest.mark.parametrize("texture", sorted(PATTERNS))
def test_pattern_is_repeatable_and_varied(texture):
    image = paint(texture)

    assert image.shape == (256, 320)
    assert image.dtype == np.float32
    assert 0.0 < image.min() < image.max() < 1.0
    assert image.std() > 0.02
    np.testing.assert_array_equal(image, paint(texture))
    assert np.abs(image - paint(texture, seed=2)).mean() > 0.005


@pytest.mark.parametrize("texture", sorted(PATTERNS))
def test_pattern_fits_any_sheet(texture):
    for sheet in (Sheet(1, 1, 0.004), Sheet(3, 90, 0.02), Sheet(90, 3, 0.001)):
        assert np.isfinite(paint(texture, sheet=sheet)).all()


def test_patterns_look_different():
    histograms = {
        name: np.histogram(paint(name), bins=32, range=(0, 1), density=True)[0] for name in PATTERNS
    }
    names = sorted(histograms)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            assert np.abs(histograms[one] - histograms[other]).mean() > 0.05, (one, other)


def test_noise_has_equal_power_in_every_octave():
    sheet = Sheet(512, 512, 0.01)
    octaves = np.zeros(4)
    for seed in range(8):
        image = noise(sheet, np.random.default_rng(seed), coarsest_m=2.56)
        power = np.abs(np.fft.fft2(image)) ** 2
        cycles = np.hypot(*np.meshgrid(np.fft.fftfreq(512) * 512, np.fft.fftfreq(512) * 512))
        octaves += [power[(cycles >= c) & (cycles < 2 * c)].sum() for c in (6, 12, 24, 48)]

    assert octaves.max() / octaves.min() < 2.0


def test_rectangle_is_where_it_should_be_to_a_fraction_of_a_texel():
    sheet = Sheet(100, 100, 0.01)
    image = sheet.filled(0.0)

    rectangle(image, sheet, (0.203, 0.405), (0.304, 0.101), 1.0)

    assert image.sum() * sheet.texel_m**2 == pytest.approx(0.304 * 0.101, rel=0.25)
    rows, columns = np.indices(image.shape)
    middle = [(image * index).sum() / image.sum() for index in (columns, rows)]
    np.testing.assert_allclose(middle, (35.0, 45.05), atol=0.1)


def test_mirrored_tiles_have_no_seams():
    motif = np.cumsum(np.random.default_rng(3).random((8, 8), np.float32), axis=1)

    tiled = mirrored(motif, 30, 40)

    assert tiled.shape == (30, 40)
    assert np.abs(np.diff(tiled, axis=1)).max() <= np.abs(np.diff(motif, axis=1)).max()


def test_picture_is_stretched_or_repeated(tmp_path):
    ramp = np.tile(np.linspace(20, 230, 64, dtype=np.uint8), (32, 1))
    cv2.imwrite(str(tmp_path / "ramp.png"), ramp)

    stretched = paint("ramp.png", folder=tmp_path)
    repeated = paint("ramp.png", folder=tmp_path, repeat_m=0.4)

    assert (np.diff(stretched.mean(axis=0)) > -1e-6).all()
    assert stretched[0, -1] == pytest.approx(230 / 255, abs=0.02)
    np.testing.assert_allclose(repeated[:, :100], repeated[:, 199:99:-1])


def test_unreadable_picture_is_named(tmp_path):
    (tmp_path / "broken.png").write_text("no picture")
    with pytest.raises(PlanError, match=r"broken\.png: not a picture"):
        paint("broken.png", folder=tmp_path)


def test_photograph_without_its_package_says_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(PlanError, match=r"box\[2\]: .* pip install scikit-image"):
        check_texture("photo:coffee", "box[2]", HERE)


def test_photograph_comes_from_the_packages_own_files(monkeypatch, tmp_path):
    (tmp_path / "data").mkdir()
    cv2.imwrite(str(tmp_path / "data" / "coffee.png"), np.full((40, 60, 3), 128, np.uint8))
    spec = importlib.util.spec_from_file_location("skimage", tmp_path / "__init__.py")
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: spec)

    np.testing.assert_allclose(paint("photo:coffee"), 128 / 255, atol=0.01)
    with pytest.raises(PlanError, match="no photograph 'tea'; allowed: coffee"):
        check_texture("photo:tea", "surface.north", HERE)


@pytest.fixture(scope="module")
def settings():
    return RoomSettings(size_m=(2.0, 3.0, 2.5), texel_m=0.01)


def test_levels_of_a_surface_keep_its_mean(settings):
    atlas = build_atlas(build_room(settings, HERE / "room.toml"))

    for surface in range(6):
        means = []
        for level in range(LEVELS):
            stride, start = atlas.stride[surface, level], atlas.start[surface, level]
            rows = round(float(atlas.scale[surface, level, 1] * atlas.size_m[surface, 1])) + 2
            image = atlas.texels[start : start + rows * stride].reshape(rows, stride)
            means.append(image[1:-1, 1:-1].mean() * FULL_SCALE / 255)
        np.testing.assert_allclose(means, means[0], atol=0.02)


def test_furniture_does_not_repaint_the_walls(settings):
    box = BoxSettings(centre_m=(0.0, 0.0, 0.5), size_m=(0.5, 0.5, 1.0))
    furnished = RoomSettings(size_m=settings.size_m, texel_m=settings.texel_m, box=(box,))
    bare_atlas = build_atlas(build_room(settings, HERE / "room.toml"))
    atlas = build_atlas(build_room(furnished, HERE / "room.toml"))

    walls = atlas.start[6, 0]
    np.testing.assert_array_equal(atlas.texels[:walls], bare_atlas.texels)


def test_room_too_large_for_its_texels_says_which_would_do():
    hall = build_room(RoomSettings(size_m=(80.0, 60.0, 10.0)), HERE / "hall.toml")
    with pytest.raises(PlanError, match=r"hall\.toml: texel_m: .*allowed: at least 0\.02"):
        build_atlas(hall)
