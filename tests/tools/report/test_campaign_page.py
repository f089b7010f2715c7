"""A page of many flights can be read: no group hides another, and what differs is told."""

import re

import numpy as np
import pytest
from matplotlib.colors import to_hex

from companion.kernel.messages import BehaviourState, Cue, Phase
from tools.agreement import Expectation
from tools.assessment import Figure
from tools.drawing import colours_of
from tools.heatmap import PAIRS_ABREAST, grid_over, heat_of
from tools.heatmap import draw as draw_heat
from tools.report import __main__ as tool
from tools.report.campaign import grouped, roc_curves
from tools.report.flight import ReportedFlight
from tools.report.model import expected_and_observed
from tools.report.plans import plans_flown

SCHEMES = ("cold_turkey", "dagger", "training_wheels")


@pytest.fixture
def crowd(invent, moment):
    """Four flights of each of three schemes; stereo calls some frames blocked."""
    learning = [moment(phase=Phase.LEARNING, cue=Cue.STEREO, place_m=(1.0, 1.0))] * 3
    turn = moment(stereo_px=5.0, mono_px=4.0, state=BehaviourState.ROTATE, place_m=(2.0, 0.0))
    paths = []
    for scheme in SCHEMES:
        for number in range(4):
            missed = [moment(stereo_px=5.0, mono_px=1.0 + number)]
            moments = [*learning, *[moment()] * 5, *missed, turn]
            name = f"{scheme}-{number}"
            paths.append(invent(moments, name=name, scheme=scheme, seed=number))
    return [ReportedFlight(path) for path in paths]


def test_every_group_has_its_own_roc_panel(crowd):
    panels = roc_curves(crowd).axes
    groups = grouped(crowd)
    assert [axes.get_title().splitlines()[0] for axes in panels] == list(groups)
    for axes, colour in zip(panels, colours_of(groups).values(), strict=True):
        curves = [line for line in axes.lines if to_hex(line.get_color()) == colour]
        assert len(curves) == 4
        (flown_at,) = [line for line in axes.lines if line.get_marker() == "."]
        assert len(flown_at.get_xdata()) == 4


def test_a_group_without_positives_leaves_no_empty_panel(crowd, invent, moment):
    clear = ReportedFlight(invent([moment()] * 9, name="clear", scheme="pure_stereo"))
    titles = [axes.get_title() for axes in roc_curves([*crowd, clear]).axes]
    assert len(titles) == 3
    assert not any("pure_stereo" in title for title in titles)


def test_a_group_keeps_its_colour_where_another_is_missing():
    colours = colours_of(["a", "b", "c"])
    expectations = [Expectation("", *(Figure(2.0, 1.0, 3.0),) * 2, 1.0)]
    unknown = [Expectation("", *(Figure(np.nan, np.nan, np.nan),) * 2, 1.0)]
    (axes,) = expected_and_observed({"a": unknown, "c": expectations}, colours).axes
    shown = {line.get_label(): line.get_color() for line in axes.lines}
    assert shown["c"] == colours["c"]


def test_heat_maps_stand_no_more_than_a_few_abreast(crowd):
    room = crowd[0].load_room()
    heats = heat_of(crowd, grid_over(room, 0.5))
    assert len(heats) > 2 * PAIRS_ABREAST
    panels = draw_heat(heats, grid_over(room, 0.5), room).axes
    drawn = [axes for axes in panels if axes.images]
    assert len(drawn) == len(heats)
    assert all(not axes.axison for axes in panels if not axes.images)
    columns = {round(axes.get_position().x0, 3) for axes in panels}
    assert len(columns) == PAIRS_ABREAST


def test_where_all_flights_begin_does_not_outshine_the_rest(invent, moment):
    """A hundred places of one frame each, after an hour in one place."""
    begin = [moment(place_m=(0.1, 0.1))] * 1000
    tour = [moment(place_m=(x, y)) for x in np.arange(-2, 2, 0.3) for y in np.arange(-2, 2, 0.3)]
    flight = ReportedFlight(invent([*begin, *tour]))
    room = flight.load_room()
    grid = grid_over(room, 0.25)
    (approach,) = [heat for heat in heat_of([flight], grid) if heat.manoeuvre == "approach"]
    panels = draw_heat([approach], grid, room).axes
    (image,) = [image for axes in panels for image in axes.images]
    assert image.get_clim()[1] == pytest.approx(0.1)
    assert approach.duration_s.max() == pytest.approx(100.1)


def test_the_plans_of_many_flights_are_told_together(crowd):
    rows = re.findall(r"<tr><td>(.*?)</td><td>(.*?)</td><td>(.*?)</td></tr>", plans_flown(crowd))
    told = {key: (flown, default) for key, flown, default in rows}
    assert told["experiment.scheme"] == (", ".join(SCHEMES), "training_wheels")
    assert told["seed"][0] == "0, 1, 2, 3"
    assert "behaviour.turn_threshold_px" not in told


def test_more_plans_than_can_be_told_are_counted(invent, moment):
    paths = [invent([moment()] * 3, name=str(seed), seed=seed) for seed in range(2, 9)]
    assert "<td>2 … 8 (7 values)</td>" in plans_flown([ReportedFlight(path) for path in paths])


def test_reading_is_silent_where_nobody_watches(crowd, tmp_path, capsys):
    assert tool.main([str(tmp_path / "logs"), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert told.out.strip() == str(tmp_path / "out" / "report.html")
