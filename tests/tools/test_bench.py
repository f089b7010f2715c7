"""The bench: fair races, and rows that say whether a goal was met."""

import json

import numpy as np
import pytest

from companion.kernel.clock import wall_s
from companion.kernel.errors import CompanionError
from companion.kernel.messages import Setpoint
from tools.bench.__main__ import main
from tools.bench.harness import Row, race_row, race_s
from tools.bench.latency import latencies_s, velocity_key
from tools.bench.process import watch
from tools.bench.reading import read, read_plainly, write_flight


def spin(duration_s):
    end_s = wall_s() + duration_s
    while wall_s() < end_s:
        pass


def test_contenders_take_turns():
    order = []
    race_s([lambda: order.append("a"), lambda: order.append("b")], rounds=5)
    assert order[-10:] == ["a", "b"] * 5


def test_a_race_finds_the_faster_one():
    row = race_row("slow", lambda: spin(4e-3), ("fast", lambda: spin(1e-3)), rounds=9)
    assert row.value >= 4.0
    assert row.baseline_value >= 1.0
    assert row.ratio < 0.6


@pytest.mark.parametrize(
    ("value", "better", "met", "ratio"),
    [(2.0, "less", True, 4.0), (16.0, "less", False, 0.5), (16.0, "more", True, 2.0)],
)
def test_ratio_and_goal_follow_what_is_better(value, better, met, ratio):
    row = Row.of("x", value, "ms", ("y", 8.0), goal=10.0, better=better)
    assert (row.met, row.ratio) == (met, ratio)


def test_a_figure_without_a_goal_is_neither_met_nor_missed():
    assert Row.of("x", 1.0, "ms", ("y", 1.0)).met is None


def test_one_subject_as_table_and_json(tmp_path, capsys):
    path = tmp_path / "rows.json"
    code = main(["--only", "log", "--json", str(path)])
    rows = json.loads(path.read_text())
    table = capsys.readouterr().out
    for row in rows:
        assert row["name"] in table
        assert row["value"] > 0.0
        assert row["baseline_value"] > 0.0
    assert code == (1 if any(row["met"] is False for row in rows) else 0)


def test_both_readers_of_a_log_read_the_same(tmp_path):
    path = tmp_path / "flight.mcap"
    write_flight(path, 3_000_000_000)
    for ours, plain in zip(read(path), read_plainly(path), strict=True):
        assert len(ours["stamp_ns"]) == 30
        np.testing.assert_equal(ours, plain)


def test_an_unknown_subject_is_a_usage_error(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--only", "nothing"])
    assert caught.value.code == 2
    assert "perception" in capsys.readouterr().err


def test_a_planted_latency_is_found_among_repetitions():
    """Each setpoint arrives 7 ms after its exposure, and once more 20 ms later; every third is
    the same as the one before and tells nothing.
    """
    setpoints, exposures, arrivals = [], {}, {}
    for number in range(30):
        frame_s, velocity = 1.0 + number / 30.0, (0.5, 0.0, -((number * 2) // 3) / 7.0)
        stamp_ns = round(frame_s * 1e9)
        setpoints.append(Setpoint(stamp_ns=stamp_ns, velocity_hfrd_m_s=velocity))
        exposures[stamp_ns] = frame_s
        arrivals.setdefault(velocity_key(*velocity), []).extend((frame_s + 7e-3, frame_s + 27e-3))
    np.testing.assert_allclose(latencies_s(iter(setpoints), exposures, arrivals), np.full(20, 7e-3))


def test_a_watched_process_that_fails_is_one_line(tmp_path):
    with pytest.raises(CompanionError, match="ZeroDivisionError"):
        watch(["-c", "1 / 0"], tmp_path)


def test_a_watched_process_shows_its_memory_and_first_frame(tmp_path):
    code = f"""
import pathlib, threading
ballast = bytes(80_000_000) and bytearray(80_000_000)
log = pathlib.Path({str(tmp_path)!r}, "run", "flight.mcap")
log.parent.mkdir()
log.write_bytes(b"header")
threading.Event().wait(0.2)
log.write_bytes(b"header and frame")
threading.Event().wait(0.1)
"""
    watched = watch(["-c", code], tmp_path)
    assert watched.peak_mb > 80.0
    assert 0.2 < watched.first_frame_s < watched.ran_s
