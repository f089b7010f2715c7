"""Flights of the office plan: in this process on simulated time, or as a user starts them."""

from functools import partial
from pathlib import Path

import pytest

from flightcard.flown import fly_in_lockstep

PLAN = Path(__file__).parents[2] / "flightplans" / "office.toml"


@pytest.fixture(scope="session")
def fly_lockstep(tmp_path_factory):
    """``fly_lockstep("experiment.scheme=dagger", ...)``: a flight with these overrides."""

    def fly(*overrides):
        return fly_in_lockstep(PLAN, overrides, tmp_path_factory.mktemp("flight"))

    return fly


@pytest.fixture
def start_companion(companion):
    """``start_companion(vehicle, *words)``: on a flight that is too long to end by itself."""
    return partial(companion.start, "office")
