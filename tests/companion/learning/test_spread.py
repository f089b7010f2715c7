"""The factor that makes a stated spread true, on planted errors."""

import math

import numpy as np
import pytest

from companion.learning.spread import FLOOR_PX, SpreadScale


def learned(errors_px, stated_px):
    scale = SpreadScale()
    for error_px, std_px in zip(errors_px, stated_px, strict=True):
        scale.learn(error_px, std_px)
    return scale


@pytest.mark.parametrize("factor", [0.5, 1.0, 4.0])
def test_a_spread_that_is_wrong_by_a_factor_becomes_true(factor):
    rng = np.random.default_rng(2)
    stated_px = rng.uniform(0.5, 2.0, 600)
    scale = learned(rng.normal(0.0, factor * np.hypot(stated_px, FLOOR_PX)), stated_px)
    assert scale.factor == pytest.approx(factor, rel=0.08)
    inside = np.abs(rng.normal(0.0, factor * 1.0, 2000)) < scale.of(1.0)
    assert inside.mean() == pytest.approx(0.68, abs=0.05)


def test_it_follows_a_learner_that_becomes_better():
    rng = np.random.default_rng(2)
    errors_px = np.concatenate([rng.normal(0, 5.0, 300), rng.normal(0, 1.0, 3000)])
    assert learned(errors_px, np.ones(3300)).factor == pytest.approx(1.0, abs=0.1)


def test_without_known_errors_it_is_as_stated():
    scale = learned([math.nan, 1.0], [1.0, math.nan])
    assert scale.of(1.0) == pytest.approx(math.hypot(1.0, FLOOR_PX))
    assert math.isnan(scale.of(math.nan))


def test_perfect_agreement_is_not_certainty():
    assert SpreadScale().of(0.0) == FLOOR_PX
