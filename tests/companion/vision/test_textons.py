"""Features are what the paper says they are; the dictionary finds what was planted."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from companion.vision.textons import (
    MID_GREY,
    TextonDictionary,
    TextonEncoder,
    TextonSettings,
    TextonTrainer,
    gradient_matrix,
    grid_places,
)

SETTINGS = TextonSettings()


@pytest.fixture(scope="module")
def images():
    """Random surfaces of several coarsenesses: (6, 96, 128)."""
    rng = np.random.default_rng(1)
    images = []
    for cell_px in (1, 2, 4, 8, 16, 32):
        cells = rng.integers(0, 256, (96 // cell_px + 1, 128 // cell_px + 1))
        image = np.kron(cells, np.ones((cell_px, cell_px)))[:96, :128]
        images.append(np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8))
    return np.array(images)


def trained(images, settings=SETTINGS, seed=2):
    trainer = TextonTrainer(settings, np.random.default_rng(seed))
    while not trainer.finished:
        for image in images:
            trainer.update(image)
    return trainer.dictionary


def encoder(dictionary, settings=SETTINGS, **options):
    return TextonEncoder(dictionary, settings, np.random.default_rng(5), **options)


def test_features_equal_their_definition(images):
    dictionary = trained(images)
    for image in images:
        places = grid_places(image.shape, 5, 500)
        patches = np.array([image[r : r + 5, c : c + 5] for r, c in places]) - MID_GREY
        halves = []
        for kind, textons in (
            (patches, dictionary.intensity),
            (np.gradient(patches, axis=2), dictionary.gradient),
        ):
            distance = ((kind.reshape(-1, 1, 25) - textons) ** 2).sum(axis=2)
            halves.append(np.bincount(distance.argmin(axis=1), minlength=10) / len(places) / 2)
        histogram = np.concatenate(halves)
        filled = histogram[histogram > 0]
        features = encoder(dictionary).encode(image)
        # One patch of 494 may lie within rounding of two textons.
        assert_allclose(features[:20], histogram, atol=1.1 / len(places) / 2)
        assert features[20] == pytest.approx(-(filled * np.log2(filled)).sum(), abs=0.02)


def test_each_half_of_the_histogram_sums_to_one_half(images):
    features = encoder(trained(images)).encode(images[0])
    assert features[:10].sum() == pytest.approx(0.5)
    assert features[10:20].sum() == pytest.approx(0.5)


def test_a_blank_image_has_one_bit_of_entropy(images):
    blank = np.full((96, 128), 90, dtype=np.uint8)
    features = encoder(trained(images)).encode(blank)
    assert np.count_nonzero(features[:20]) == 2
    assert features[20] == pytest.approx(1.0)


def test_entropy_scale_touches_nothing_but_the_entropy(images):
    dictionary = trained(images)
    plain = encoder(dictionary).encode(images[2])
    scaled = encoder(dictionary, entropy_scale=0.25).encode(images[2])
    assert_array_equal(scaled[:20], plain[:20])
    assert scaled[20] == pytest.approx(plain[20] / 4)


def test_gradient_is_central_inside_and_one_sided_at_the_edge_columns():
    patch = np.random.default_rng(0).random((5, 5))
    expected = np.gradient(patch, axis=1)
    assert_allclose(gradient_matrix(5) @ patch.ravel(), expected.ravel(), atol=1e-6)


@given(height=st.integers(20, 300), width=st.integers(20, 300), patches=st.sampled_from([50, 500]))
def test_grid_spans_the_image_with_about_as_many_patches_as_asked_for(height, width, patches):
    places = grid_places((height, width), 5, patches)
    assert len(np.unique(places, axis=0)) == len(places)
    assert_array_equal(places.min(axis=0), 0)
    assert_array_equal(places.max(axis=0), (height - 5, width - 5))
    available = (height - 4) * (width - 4)
    assert 0.7 * min(patches, available / 2) <= len(places) <= 1.2 * patches


def test_the_papers_camera_gets_its_five_hundred_patches():
    assert abs(len(grid_places((96, 128), 5, 500)) - 500) <= 20


def test_textons_settle_on_planted_patches():
    """An image of four flat greys: far from their borders all patches are one of four."""
    image = np.kron(np.array([[20, 90], [160, 230]]), np.ones((200, 200))).astype(np.uint8)
    settings = TextonSettings(intensity=4, gradient=1)
    found = trained([image], settings).intensity.mean(axis=1) + MID_GREY
    assert_allclose(np.sort(found), [20, 90, 160, 230], atol=8)


def test_more_textons_describe_patches_better(images):
    places = grid_places((96, 128), 5, 500)
    patches = np.array([i[r : r + 5, c : c + 5] for i in images for r, c in places]) - MID_GREY

    def error(n_textons):
        textons = trained(images, TextonSettings(intensity=n_textons)).intensity
        return ((patches.reshape(-1, 1, 25) - textons) ** 2).sum(axis=2).min(axis=1).mean()

    assert error(20) < error(10) < error(4) < error(1)


def test_same_seed_same_dictionary_and_another_seed_another(images):
    first, second, other = trained(images), trained(images), trained(images, seed=3)
    assert_array_equal(first.intensity, second.intensity)
    assert_array_equal(first.gradient, second.gradient)
    assert not np.array_equal(first.intensity, other.intensity)


def test_a_dictionary_handed_out_does_not_change_any_more(images):
    trainer = TextonTrainer(SETTINGS, np.random.default_rng(2))
    trainer.update(images[0])
    early = trainer.dictionary
    copy = early.intensity.copy()
    trainer.update(images[1])
    assert_array_equal(early.intensity, copy)


def test_random_patches_vary_but_tell_about_the_same(images):
    settings = msgspec.structs.replace(SETTINGS, sampling="random", patches=5000)
    drawing = encoder(trained(images), settings)
    first, second = drawing.encode(images[3]), drawing.encode(images[3])
    assert not np.array_equal(first, second)
    assert_allclose(first[:20], second[:20], atol=0.03)


def test_images_from_a_read_only_or_strided_buffer_do_as_well(images):
    dictionary = trained(images)
    wide = np.concatenate([images[0], images[1]], axis=1)
    wide.flags.writeable = False
    plain = encoder(dictionary).encode(images[0])
    assert_array_equal(encoder(dictionary).encode(wide[:, :128]), plain)


@pytest.mark.parametrize("shape", [(48, 64), (96, 128), (480, 640)])
def test_one_encoder_takes_images_of_any_size(images, shape):
    dictionary = TextonDictionary(*trained(images))
    image = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    assert encoder(dictionary).encode(image).shape == (21,)
