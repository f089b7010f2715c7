"""The clocks of two logs of one flight: a planted distance is found again."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tools.logs import __main__ as logs
from tools.logs import open_log
from tools.logs.align import align

EXACT_S = 0.02
offsets_s = st.floats(-4.0, 1.7e9)
"""From a log that began a little earlier to one on wall time since 1970."""


def align_files(one, other):
    return align(open_log(one), open_log(other))


@settings(max_examples=5)
@given(offset_s=offsets_s, seed=st.integers(0, 1000), camera_s=st.floats(-4.0, 1000.0))
def test_a_planted_offset_is_found_again(tmp_path_factory, invented, offset_s, seed, camera_s):
    folder, motion = tmp_path_factory.mktemp("align"), invented.Motion(seed)
    ours = invented.flight(folder / "a.mcap", motion, camera_ahead_s=camera_s)
    theirs = invented.tlog(folder / "a.tlog", motion, clock_s=offset_s)
    fit = align_files(ours, theirs)
    assert fit.offset_s == pytest.approx(camera_s - offset_s, abs=EXACT_S)
    assert fit.correlation > 0.95


def test_px4s_log_is_aligned_too(tmp_path, invented):
    motion = invented.Motion(seed=3)
    ours = invented.flight(tmp_path / "a.mcap", motion, camera_ahead_s=100.0)
    fit = align_files(ours, invented.ulog(tmp_path / "a.ulg", motion, clock_s=31.234))
    assert fit.offset_s == pytest.approx(100.0 - 31.234, abs=EXACT_S)
    assert fit.signal == "yaw rate"


def test_a_log_that_began_later_is_aligned(tmp_path, invented):
    motion = invented.Motion(seed=4)
    ours = invented.flight(tmp_path / "a.mcap", motion, skip=range(250))
    fit = align_files(ours, invented.tlog(tmp_path / "a.tlog", motion, clock_s=7.7))
    assert fit.offset_s == pytest.approx(-7.7, abs=EXACT_S)


def test_height_serves_where_yaw_rate_is_unknown(tmp_path, invented):
    motion = invented.Motion(seed=5)
    ours = invented.flight(tmp_path / "a.mcap", motion, yaw_known=False)
    fit = align_files(ours, invented.tlog(tmp_path / "a.tlog", motion, clock_s=-2.5))
    assert fit.signal == "height"
    assert fit.offset_s == pytest.approx(2.5, abs=EXACT_S)


@pytest.mark.parametrize("seed", range(5))
def test_another_flight_is_refused(tmp_path, invented, capsys, seed):
    ours = invented.flight(tmp_path / "a.mcap", invented.Motion(seed))
    theirs = invented.tlog(tmp_path / "a.tlog", invented.Motion(seed + 100))
    assert logs.main(["align", str(ours), str(theirs)]) == 1
    assert "shows another flight" in capsys.readouterr().err


def test_a_flight_too_short_to_tell_is_refused(tmp_path, invented, capsys):
    motion = invented.Motion(seed=1, duration_s=5.0)
    ours = invented.flight(tmp_path / "a.mcap", motion)
    words = ["align", str(ours), str(invented.tlog(tmp_path / "a.tlog", motion))]
    assert logs.main(words) == 1
    assert "neither yaw rate nor height" in capsys.readouterr().err


def test_the_command_writes_json_and_export_moves_times(tmp_path, invented, capsys):
    motion = invented.Motion(seed=6)
    ours = invented.flight(tmp_path / "a.mcap", motion)
    theirs = invented.tlog(tmp_path / "a.tlog", motion, clock_s=1000.0)
    assert logs.main(["align", str(ours), str(theirs), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["offset_s"] == pytest.approx(-1000, abs=EXACT_S)
    words = ["export", str(theirs), "--align-to", str(ours), "--out", str(tmp_path / "csv")]
    assert logs.main(words) == 0
    first = (tmp_path / "csv" / "ATTITUDE.csv").read_text().splitlines()[1]
    assert float(first.split(",")[0]) == pytest.approx(5.0, abs=EXACT_S)
