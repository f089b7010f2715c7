"""Stays in zones, of a flight whose errors are planted."""

import pytest

from tools import stays
from tools.flown import FlownFlight

ZONES = [
    {"from_s": 0.0, "centre_m": [0.0, 0.0], "radius_m": 2.0},
    {"from_s": 90.0, "centre_m": [1.0, 0.0], "radius_m": 0.5},
    {"from_s": 100.0, "centre_m": [5.0, 0.0], "radius_m": 2.0},
]


@pytest.fixture
def flown(invent, moment):
    """100 s half a pixel off, of which the door's are a part; 30 s off by 2, 70 s by 1."""
    errors_px = [0.5] * 1000 + [2.0] * 300 + [1.0] * 700
    moments = [moment(mono_px=2.0 + error_px) for error_px in errors_px]
    moments[1500] = moments[1500]._replace(override=True)
    return invent(moments, behaviour={"zone": ZONES})


def test_each_stay_has_its_errors_at_first_and_then(flown):
    one, other = stays.stays_of(FlownFlight(flown))
    assert (one.from_s, one.to_s, other.from_s) == (0.0, 100.0, 100.0)
    assert (one.first_error_px, one.then_error_px) == pytest.approx((0.5, 0.5))
    assert (other.first_error_px, other.then_error_px) == pytest.approx((2.0, 1.0), abs=0.01)
    assert (one.overrides, other.overrides) == (0, 1)


def test_the_command_prints_a_line_per_stay(flown, capsys):
    assert stays.main([str(flown.parent)]) == 0
    header, *lines = capsys.readouterr().out.splitlines()
    assert "novelty" in header
    assert [line.split()[1] for line in lines] == ["0", "100"]


def test_a_flight_without_zones_is_refused_in_one_line(invent, moment, capsys):
    assert stays.main([str(invent([moment()]))]) == 2
    assert "no behaviour.zone" in capsys.readouterr().err
