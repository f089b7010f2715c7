"""The bench: fair races, and rows that say whether a goal was met."""

import json

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.flightlog import FlightLogWriter, FlightMetadata, Topic
from companion.kernel.clock import wall_s
from companion.kernel.messages import Setpoint
from sitl.mavlink.tlog import TelemetryLog
from tools.bench.__main__ import main
from tools.bench.harness import Row, race_row, race_s
from tools.bench.latency import latencies_s


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


def test_an_unknown_subject_is_a_usage_error(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--only", "nothing"])
    assert caught.value.code == 2
    assert "perception" in capsys.readouterr().err


def test_a_planted_latency_is_found_among_repetitions(tmp_path):
    """Each setpoint arrives 7 ms after its frame, and once more 20 ms later."""
    sender = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
    link = TelemetryLog(tmp_path / "sitl.tlog")
    metadata = FlightMetadata(plan={}, seed=1, version="0")
    with FlightLogWriter(tmp_path / "flight.mcap", metadata) as log:
        for number in range(20):
            frame_s, climb_m_s = 1.0 + number / 30.0, -number / 7.0
            setpoint = Setpoint(
                stamp_ns=round(frame_s * 1e9), velocity_hfrd_m_s=(0.5, 0.0, climb_m_s)
            )
            log.write(Topic.SETPOINT, setpoint)
            for late_s in (0.007, 0.027):
                message = mavlink.MAVLink_set_position_target_local_ned_message(
                    0,
                    1,
                    1,
                    mavlink.MAV_FRAME_BODY_NED,
                    0,
                    0,
                    0,
                    0,
                    0.5,
                    0.0,
                    climb_m_s,
                    0,
                    0,
                    0,
                    0,
                    0,
                )
                link.write(frame_s + late_s, message.pack(sender))
    link.close()
    np.testing.assert_allclose(latencies_s(tmp_path), np.full(20, 0.007), atol=2e-6)
