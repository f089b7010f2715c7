"""The picture of a flight, from invented logs."""

import pytest

from companion.flightlog import FlightLogWriter, FlightMetadata, Topic
from companion.kernel.messages import (
    BehaviourState,
    Cue,
    Decision,
    Percept,
    Phase,
    Telemetry,
)
from tools import picture
from tools.flown import FlownFlight

SECOND_NS = 1_000_000_000


def write_log(path, phases):
    with FlightLogWriter(path, FlightMetadata(plan={}, seed=1, version="0")) as log:
        for second, phase in enumerate(phases):
            stamp_ns = second * SECOND_NS
            log.write(
                Topic.PERCEPT,
                Percept(
                    stamp_ns=stamp_ns,
                    stereo_px=2.0,
                    stereo_valid_norm=1.0,
                    mono_px=2.5,
                    mono_std_px=0.1,
                ),
            )
            log.write(
                Topic.DECISION,
                Decision(
                    stamp_ns=stamp_ns,
                    phase=phase,
                    cue=Cue.MONO,
                    override=second % 3 == 0,
                    disparity_px=2.5,
                    threshold_px=4.0,
                    state=BehaviourState.STRAIGHT,
                    overrides=second,
                    turns=2 * second,
                    approaches=1,
                ),
            )
            place = (0.1 * second, 0.0, -1.2)
            log.write(Topic.TELEMETRY, Telemetry(stamp_ns=stamp_ns, position_ned_m=place))
    return path


def test_draws_a_whole_flight_without_motion_capture(tmp_path, capsys):
    phases = [Phase.INITIAL] * 3 + [Phase.LEARNING] * 3 + [Phase.TEST] * 3
    log = write_log(tmp_path / "flight.mcap", phases)
    assert picture.main([str(log)]) == 0
    assert (tmp_path / "flight.png").stat().st_size > 10_000
    assert capsys.readouterr().out.strip() == str(tmp_path / "flight.png")


def test_the_same_flight_gives_the_same_file(tmp_path):
    log = write_log(tmp_path / "flight.mcap", [Phase.INITIAL, Phase.LEARNING])
    pictures = [tmp_path / name for name in ("one.png", "two.png")]
    for path in pictures:
        assert picture.main([str(log), "--out", str(path)]) == 0
    assert pictures[0].read_bytes() == pictures[1].read_bytes()


def test_each_panel_says_what_its_phase_counted(tmp_path):
    log = write_log(tmp_path / "flight.mcap", [Phase.INITIAL] * 2 + [Phase.TEST] * 2)
    figure = picture.draw(FlownFlight(log), None)
    titles = [axes.get_title() for axes in figure.subfigs[0].axes]
    assert titles == [
        "initial: 2 turns, 1 overrides",
        "learning: not flown",
        "test: 6 turns, 3 overrides",
    ]


@pytest.mark.parametrize("content", [b"", b"not a log"])
def test_no_log_is_one_line(tmp_path, capsys, content):
    path = tmp_path / "flight.mcap"
    path.write_bytes(content)
    assert picture.main([str(path)]) == 1
    assert "flight.mcap" in capsys.readouterr().err
