"""Figures and tables show what the logs hold."""

import csv
import json
import math

import numpy as np
import pytest

from companion.flightlog import FlightLog
from companion.kernel.messages import BehaviourState, Cue, Phase
from companion.learning.learner import Learner
from companion.modelfile import load_dictionary
from companion.plan import Plan
from sitl.arena.room import load_room
from tools import flightpath, heatmap, look, risk, roc, table2, textons
from tools.agreement import Expectation, agreement
from tools.assessment import Figure, assess
from tools.flown import ROOMS, FlownFlight, find_logs

ROTATE = BehaviourState.ROTATE


def read_csv(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def story(moment):
    """Stereo flies 10 frames; mono 20 ahead (2 of them positive, 1 detected) and 4 of turning."""
    ahead = [moment(place_m=(1.1, -0.9))] * 17
    return [
        *[moment(phase=Phase.INITIAL, cue=Cue.STEREO)] * 10,
        *ahead,
        moment(stereo_px=5.0),
        moment(mono_px=3.8),
        moment(stereo_px=5.0, mono_px=4.0, state=ROTATE, place_m=(2.0, 2.0)),
        *[moment(state=ROTATE, place_m=(2.0, 2.0))] * 4,
    ]


def test_a_heat_map_counts_seconds_where_they_were_spent(invent, story, tmp_path):
    path = invent(story)
    assert heatmap.main([str(path), "--out", str(tmp_path / "out"), "--phase", "test"]) == 0
    rows = read_csv(tmp_path / "out" / "heatmap-room1.csv")
    cells = {(r["manoeuvre"], r["north_m"], r["east_m"]): float(r["duration_s"]) for r in rows}
    assert cells[("approach", "1.125", "-0.875")] == pytest.approx(1.7)
    assert cells[("turn", "2.125", "2.125")] == pytest.approx(0.5)
    assert {row["cue"] for row in rows} == {"mono"}
    for kind in ("png", "svg"):
        assert (tmp_path / "out" / f"heatmap-room1.{kind}").stat().st_size > 5000


def test_flights_of_a_scheme_share_a_heat_map(invent, story):
    paths = [invent(story, name=f"flight{i}", scheme=s) for i, s in enumerate(("dagger",) * 2)]
    paths.append(invent(story, name="other", scheme="cold_turkey"))
    flights = [FlownFlight(path) for path in paths]
    room = flights[0].load_room()
    heats = heatmap.heat_of(flights, heatmap.grid_over(room, 0.5), "test")
    total_s = {(h.scheme, h.manoeuvre): h.duration_s.sum() for h in heats}
    assert total_s[("dagger", "approach")] == pytest.approx(3.8)
    assert total_s[("cold_turkey", "approach")] == pytest.approx(1.9)


def test_what_was_recovered_of_a_flight_is_not_another_flight(invent, story):
    path = invent(story)
    path.with_name("flight.recovered.mcap").write_bytes(path.read_bytes())
    assert find_logs([path.parent]) == [path]


def test_the_operating_point_is_that_of_the_flight(invent, story, tmp_path):
    path = invent(story)
    assert roc.main([str(path), "--out", str(tmp_path)]) == 0
    (point,) = json.loads((tmp_path / "roc.json").read_text())
    assert (point["tpr"], point["threshold_px"]) == (0.5, 3.5)
    assert point["fpr"] == pytest.approx(1 / 22)
    corners = read_csv(tmp_path / "roc.csv")
    reached = [c for c in corners if float(c["threshold_px"]) >= 3.5]
    assert float(reached[-1]["tpr"]) == point["tpr"]


def test_many_flights_are_drawn_by_scheme(invent, story, moment):
    """Also a scheme whose flights have no curve."""
    rocs = [roc.roc_of(FlownFlight(invent(story, scheme="dagger")))] * roc.LEGEND_LIMIT
    silent = roc.roc_of(FlownFlight(invent([moment()] * 5, name="none", scheme="cold_turkey")))
    panels = roc.draw([*rocs, silent]).axes
    assert [axes.get_title().splitlines() for axes in panels] == [
        ["room1, dagger", f"{roc.LEGEND_LIMIT} flights, AUC {rocs[0].auc:.2f}"],
        ["room1, cold turkey", "1 flight, AUC –"],
    ]
    assert len(roc.draw(rocs).axes) == 1


def test_a_flight_without_positives_still_has_a_picture(invent, moment, tmp_path):
    assert roc.main([str(invent([moment()] * 5)), "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "roc.json").read_text())[0]["auc"] is None


def test_risk_tells_what_was_observed(invent, story, moment, tmp_path, capsys):
    path = invent([*story, moment(stereo_px=6.0, cue=Cue.STEREO, override=True, collisions=1)])
    assert risk.main([str(path), "--json", str(tmp_path / "risk.json")]) == 0
    report = json.loads((tmp_path / "risk.json").read_text())
    assert report["observed"]["override"] == report["observed"]["collision"] == 1.0
    assert report["from_test"]["positives"] == 3
    assert report["from_learning"]["collision"]["value"] is None  # no positive yet
    out = capsys.readouterr().out
    assert "collision per approach, chain" in out
    assert "nan" not in out


def test_risk_knows_no_collisions_without_the_truth(invent, story, capsys):
    report = assess(FlownFlight(invent(story, truth=False)))
    assert report.observed.collision is None
    assert report.observed.override == 0.0
    assert math.isnan(report.from_learning.tpr.value)


def test_risk_repeats_itself(real_flight):
    flight = FlownFlight(real_flight.log_path)
    one, other = (list(risk.table_lines(assess(flight, seed=3))) for _ in range(2))
    assert one == other


def test_risk_of_many_flights_adds_them_up(invent, story, moment, tmp_path, capsys):
    override = moment(stereo_px=6.0, cue=Cue.STEREO, override=True)
    before = [moment(phase=Phase.LEARNING), moment(phase=Phase.LEARNING, stereo_px=5.0)]
    for name in ("a", "b"):
        invent([*before, *story, override], name=name)
    invent([moment()] * 5, name="c")  # without positives nothing is known
    assert risk.main([str(tmp_path / "logs"), "--json", str(tmp_path / "risk.json")]) == 0
    *_, all_flights, ratios = capsys.readouterr().out.splitlines()
    assert all_flights.split()[-1] == "2.0"
    reports = json.loads((tmp_path / "risk.json").read_text())
    assert [report["flight"] for report in reports] == ["a", "b", "c"]
    expected = sum(report["from_test"]["override"]["value"] or 0.0 for report in reports)
    assert float(all_flights.split()[-2]) == pytest.approx(expected, abs=0.05)
    assert ratios.startswith("observed / expected")


def test_the_model_agrees_with_flights_drawn_from_it():
    rng = np.random.default_rng(2)
    rate = rng.uniform(2.0, 20.0, 60)
    flights = [
        Expectation("", Figure(mean, mean, mean), Figure(mean / 2, 0.0, mean), count)
        for mean, count in zip(rate, rng.poisson(rate), strict=True)
    ]
    unknown = Expectation("", *(Figure(math.nan, math.nan, math.nan),) * 2, 7.0)
    found = agreement([*flights, unknown], rng)
    assert found.flights == 60
    assert found.ratio_learning.low < 1.0 < found.ratio_learning.high
    assert found.ratio_test.value == pytest.approx(2 * found.ratio_learning.value)
    assert found.ratio_test.low > 1.5


def test_a_model_that_expects_nothing_has_no_ratio():
    nothing = Figure(0.0, 0.0, 0.0)
    found = agreement([Expectation("", nothing, nothing, 0.0)], np.random.default_rng(1))
    assert math.isnan(found.ratio_learning.value)
    assert agreement([], np.random.default_rng(1)).flights == 0


def test_table_2_is_the_same_from_summary_and_log(real_flight):
    summary = table2.column_of_summary(real_flight.log_dir / "summary.json")
    log = table2.column_of_log(FlownFlight(real_flight.log_path))
    assert summary.room == log.room == "room1"
    for field in table2.ROWS.values():
        assert getattr(log, field) == pytest.approx(getattr(summary, field)), field


def test_table_2_averages_and_is_written(invent, story, moment, tmp_path, capsys):
    invent(story, name="a")
    invent([moment(mono_px=3.0)] * 11, name="b")
    out = tmp_path / "out"
    assert table2.main([str(tmp_path / "logs"), "--out", str(out)]) == 0
    rows = {row["flight"]: row for row in read_csv(out / "table2.csv")}
    assert float(rows["mse"]["2"]) == 1.0
    assert float(rows["mse"]["average"]) == pytest.approx((float(rows["mse"]["1"]) + 1.0) / 2)
    assert rows["tpr"]["2"] == ""  # no positives
    assert rows["tpr"]["average"] == rows["tpr"]["1"]
    printed = capsys.readouterr().out
    assert "True Positive Rate" in printed
    assert "–" in printed
    assert (out / "table2.md").read_text().splitlines()[1] == "|---|--:|--:|--:|"


def test_the_flight_path_shows_the_log_and_the_theory(real_flight, tmp_path):
    stem = tmp_path / "path"
    assert flightpath.main([str(real_flight.log_path), "--out", str(stem)]) == 0
    rows = read_csv(stem.with_suffix(".csv"))
    percept = FlightLog(real_flight.log_path).columns("/percept")
    stereo_px = [float(row["stereo_px"] or "nan") for row in rows]
    assert stereo_px == pytest.approx(percept["stereo_px"], rel=1e-5, nan_ok=True)
    theory_px = np.array([float(row["theory_px"]) for row in rows])
    assert np.corrcoef(theory_px, percept["stereo_px"])[0, 1] > 0.95
    assert {row["mono"] for row in rows} == {"True", "False"}


def test_theory_is_what_a_look_from_the_same_place_tells(invent, moment):
    room = load_room(ROOMS / "room1.toml")
    flight = FlownFlight(invent([moment(place_m=(0.5, -1.0))]))
    (theory_px,) = flightpath.theoretical_disparity_px(flight, room)
    assert theory_px == pytest.approx(look.look(room, (0.5, -1.0, 1.2, 0.0))[1])


def test_false_alarms_and_misses_are_drawn_where_mono_flew(invent, story):
    flight = FlownFlight(invent(story))
    path = flightpath.path_of(flight, flight.load_room(), "test")
    panels = {panel.title[0]: panel for panel in flightpath.panels_of(path)}
    assert np.flatnonzero(panels["E"].shown).tolist() == [18]
    assert np.flatnonzero(panels["F"].shown).tolist() == [17]
    assert panels["F"].value_px[17] == 3.0
    assert path.approach[[0, 18, 23]].tolist() == [1, 1, 1]


def test_the_dictionarys_table_holds_its_textons(real_flight, tmp_path):
    model = real_flight.log_dir / "model.npz"
    assert textons.main([str(model), "--out", str(tmp_path / "textons")]) == 0
    rows = read_csv(tmp_path / "textons.csv")
    dictionary = load_dictionary(model)
    values = [[float(row[f"value_{i}"]) for i in range(25)] for row in rows]
    assert np.allclose(values, np.concatenate(dictionary), rtol=1e-4, atol=1e-4)
    assert (tmp_path / "textons.svg").exists()


def test_a_films_histograms_are_the_learners(real_flight, tmp_path):
    words = [str(real_flight.log_path), "--every", "40", "--out", str(tmp_path / "film")]
    assert textons.main(words) == 0
    rows = read_csv(tmp_path / "film.csv")
    learner = Learner(
        Plan().learner, np.random.default_rng(0), load_dictionary(real_flight.log_dir / "model.npz")
    )
    frames = list(FlightLog(real_flight.log_path).frames())[::40]
    assert len(rows) == len(frames) == 5
    for row, frame in zip(rows, frames, strict=True):
        shown = [float(value) for value in list(row.values())[3:]]
        # A patch halfway between two textons may fall to either.
        assert np.abs(learner.observe(frame.left)[:-1] - shown).sum() < 0.005
    with textons.Image.open(tmp_path / "film.png") as film:
        assert film.n_frames == 5


def test_a_film_outside_of_the_flight_is_refused(real_flight, capsys):
    assert textons.main([str(real_flight.log_path), "--first-s", "99", "--last-s", "100"]) == 2
    assert "no frame from 99 to 100 s" in capsys.readouterr().err


@pytest.mark.parametrize("tool", ["heatmap", "roc"])
def test_the_same_flights_give_the_same_files(tool, invent, story, tmp_path):
    path = invent(story)
    folders = [tmp_path / name for name in ("one", "other")]
    for folder in folders:
        assert {"heatmap": heatmap, "roc": roc}[tool].main([str(path), "--out", str(folder)]) == 0
    one, other = ([p.read_bytes() for p in sorted(f.iterdir())] for f in folders)
    assert one == other
