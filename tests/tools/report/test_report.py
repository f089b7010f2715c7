"""The report of a real (simulated) flight says what the flight said."""

import re
import shutil

import msgspec
import pytest

from companion.kernel.messages import Event
from companion.summary import table_rows
from tools import risk
from tools.assessment import assess
from tools.flown import FlownFlight
from tools.logs.recover import recover
from tools.report import __main__ as tool
from tools.report.flight import ReportedFlight, overrides, read_summary
from tools.report.page import Page, folded, paragraph, table
from tools.report.sections import flight_page


@pytest.fixture
def folder(flown_dir, tmp_path):
    return shutil.copytree(flown_dir, tmp_path / "room1-flight")


def text_of(path):
    """The page as one line of words."""
    html = re.sub(r"<style>.*?</style>|<img[^>]*>", " ", path.read_text(), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", html).split())


def test_the_report_holds_the_flights_table(folder, capsys):
    assert tool.main([str(folder)]) == 0
    path = folder / "report.html"
    assert capsys.readouterr().out.strip() == str(path)
    text = text_of(path)
    for name, value in table_rows(read_summary(folder / "summary.json")):
        assert f"{name} {value}" in text
    assert "flight.mcap: sound, " in text
    assert "experiment.initial_s 8" in text
    figures = {file.name for file in (folder / "figures").iterdir()}
    assert {"path.png", "path.svg", "disparity.png", "roc.png", "flightpath.png"} <= figures


def test_the_report_holds_the_flights_risk(folder, tmp_path):
    log = folder / "flight.mcap"
    text = text_of(tool.report(log, tmp_path / "out"))
    for row in risk.table_rows(assess(FlownFlight(log))):
        assert " ".join(" ".join(row).split()) in text


def test_a_figure_that_cannot_be_drawn_says_why(folder, monkeypatch, tmp_path):
    monkeypatch.setattr("tools.flown.ROOMS", tmp_path)
    text = text_of(tool.report(folder))
    assert "λ along the path not shown" in text
    assert "no shipped room &#x27;room1&#x27;; give --room" in text


def test_a_room_that_is_not_there_is_a_usage_error(folder, capsys):
    assert tool.main([str(folder), "--room", str(folder / "none.toml")]) == 2
    assert "none.toml" in capsys.readouterr().err


def test_the_same_flight_gives_the_same_report(folder, tmp_path):
    pages = [tmp_path / name for name in ("one", "two")]
    for out in pages:
        assert tool.main([str(folder / "flight.mcap"), "--out", str(out)]) == 0
    assert (pages[0] / "report.html").read_bytes() == (pages[1] / "report.html").read_bytes()


def test_a_log_alone_is_counted_as_the_flight_counted(folder):
    told = read_summary(folder / "summary.json")
    (folder / "summary.json").unlink()
    counted = ReportedFlight(folder / "flight.mcap").summary
    assert table_rows(counted) == table_rows(told)
    assert repr(counted.phases) == repr(told.phases)
    assert counted.minimum_clearance_m == pytest.approx(told.minimum_clearance_m)


def test_overrides_are_those_that_the_flight_counted(folder):
    flight = ReportedFlight(folder / "flight.mcap")
    listed = overrides(flight)
    for name, phase in flight.summary.phases.items():
        assert sum(event.phase == name for event in listed) == phase.overrides
    threshold_px = flight.plan.behaviour.override_threshold_px
    assert all(event.stereo_px > threshold_px for event in listed)
    assert listed


def test_a_killed_flight_is_recovered_and_reported(folder):
    log = folder / "flight.mcap"
    log.write_bytes(log.read_bytes()[: log.stat().st_size * 3 // 4])
    killed = msgspec.structs.replace(
        read_summary(folder / "summary.json"), outcome="failed", reason="was killed", frames=0
    )
    (folder / "summary.json").write_bytes(msgspec.json.encode(killed).ljust(4096))
    assert tool.main([str(folder)]) == 0
    text = text_of(folder / "report.html")
    assert "failed: was killed; counted anew from the log" in text
    assert "problem cut off" in text
    recover(log, folder / "saved.mcap")
    assert ReportedFlight(folder / "saved.mcap").summary.frames == killed_frames(text)


def killed_frames(text):
    return int(re.search(r"(\d+) frames", text)[1])


def test_a_log_without_truth_has_a_report(folder, without_truth):
    assert tool.main([str(without_truth(folder / "flight.mcap", folder / "blind.mcap"))]) == 0
    text = text_of(folder / "report.html")
    assert "collisions unknown" in text
    assert "Collisions (truth) unknown" in text
    assert re.search(r"λ along the path not shown: \S*blind.mcap: no truth", text)


def test_what_the_companion_said_in_flight_is_told(folder, without_truth):
    event = Event(stamp_ns=9_000_000_000, severity="warning", text="no frames for 0.6 s")
    log = without_truth(folder / "flight.mcap", folder / "told.mcap", event)
    began_s = ReportedFlight(log).percept["stamp_ns"][0] * 1e-9
    page = Page("events")
    flight_page(ReportedFlight(log), page)
    assert f"<td>{9 - began_s:.1f}</td><td>warning</td><td>no frames for 0.6 s</td>" in page.html()


def test_many_flights_share_a_page(flown_dir, tmp_path):
    for name in ("one", "two"):
        shutil.copytree(flown_dir, tmp_path / "many" / name)
    (tmp_path / "many" / "two" / "broken.mcap").write_bytes(b"\x89MCAP0\r\n no more")
    assert tool.main([str(tmp_path / "many")]) == 0
    text = text_of(tmp_path / "many" / "report.html")
    assert "room1, training_wheels 2 of 2" in text
    assert "Heat map, room1" in text
    assert "Performance model Overrides in the test phase" in text
    assert (tmp_path / "many" / "figures" / "heatmap-room1.png").stat().st_size > 5000
    assert re.search(r"Not shown \S*broken.mcap: not a flight log", text)


MISTAKES = {
    "missing": (lambda path: None, "cannot be read: No such file"),
    "empty folder": (lambda path: path.mkdir(), "holds no flight log"),
    "no log": (lambda path: path.write_text("hello"), "not a flight log"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_cannot_be_reported_is_one_line(tmp_path, capsys, mistake):
    make, said = MISTAKES[mistake]
    make(tmp_path / "log")
    assert tool.main([str(tmp_path / "log"), "--out", str(tmp_path)]) == 1
    text = capsys.readouterr().err
    assert said in text
    assert text.count("\n") == 1
    assert not (tmp_path / "report.html").exists()


def test_damage_inside_is_one_line(folder, capsys):
    log = folder / "flight.mcap"
    content = bytearray(log.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 64] = bytes(64)
    log.write_bytes(content)
    assert tool.main([str(folder)]) == 1
    text = capsys.readouterr().err
    assert "damaged" in text
    assert text.count("\n") == 1


def test_words_cannot_break_the_page():
    bad = "<script>alert('&')</script>"
    page = Page(bad)
    page.add(bad, paragraph(bad), table((bad,), [(bad,)]), folded(bad, ""))
    assert "<script" not in page.html()
    assert page.html().count("&lt;script&gt;alert(&#x27;&amp;&#x27;)&lt;/script&gt;") == 8
