"""Two estimates as one: the identities of inverse variances, and planted noise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.learning.fusion import UNKNOWN, Estimate, fuse, stereo_estimate

DISPARITY = st.floats(-2, 40)
STD = st.floats(0.01, 20)
ESTIMATE = st.builds(Estimate, DISPARITY, STD)


@given(one=ESTIMATE, other=ESTIMATE)
def test_it_lies_between_the_two_and_is_no_less_certain_than_either(one, other):
    fused = fuse(one, other)
    low, high = sorted((one.disparity_px, other.disparity_px))
    assert low - 1e-9 <= fused.disparity_px <= high + 1e-9
    assert fused.std_px <= min(one.std_px, other.std_px) + 1e-9
    assert fused == pytest.approx(fuse(other, one))
    assert 1 / fused.std_px**2 == pytest.approx(1 / one.std_px**2 + 1 / other.std_px**2)


@given(known=ESTIMATE)
def test_what_is_unknown_leaves_the_other_as_it_is(known):
    assert fuse(known, UNKNOWN) == fuse(UNKNOWN, known) == known
    unsure = Estimate(1.0, math.nan)
    assert fuse(known, unsure) == fuse(unsure, known) == known
    assert math.isnan(fuse(UNKNOWN, UNKNOWN).disparity_px)


def test_two_that_are_certain_share():
    assert fuse(Estimate(1.0, 0.0), Estimate(2.0, 0.0)) == Estimate(1.5, 0.0)


def test_planted_noise_is_averaged_away_as_the_variances_say():
    rng = np.random.default_rng(3)
    errors = np.array(
        [
            fuse(Estimate(rng.normal(3, 0.5), 0.5), Estimate(rng.normal(3, 1.0), 1.0)).disparity_px
            for _ in range(4000)
        ]
    )
    assert errors.mean() == pytest.approx(3.0, abs=0.03)
    assert errors.std() == pytest.approx(math.sqrt(0.2), rel=0.05)


@given(disparity_px=st.floats(0, 30), valid_norm=st.floats(0, 1), more=st.floats(0, 1))
def test_stereo_is_the_more_certain_the_more_it_matched(disparity_px, valid_norm, more):
    better = valid_norm + more * (1 - valid_norm)
    stds = [stereo_estimate(disparity_px, share).std_px for share in (valid_norm, better)]
    assert 0.0 < stds[1] <= stds[0]


def test_an_unknown_disparity_stays_unknown():
    assert math.isnan(stereo_estimate(math.nan, 0.0).disparity_px)
