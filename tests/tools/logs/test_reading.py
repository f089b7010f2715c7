"""Logs of three kinds, read through one interface."""

import csv

import numpy as np
import pytest

from tools.logs import __main__ as logs
from tools.logs import open_log


@pytest.fixture
def motion(invented):
    return invented.Motion(seed=1, duration_s=20.0)


@pytest.fixture(params=["flight", "tlog", "ulog"])
def any_log(request, tmp_path, invented, motion):
    suffix = {"flight": "mcap", "tlog": "tlog", "ulog": "ulg"}[request.param]
    return getattr(invented, request.param)(tmp_path / f"some.{suffix}", motion)


YAW_RATE = {
    ".mcap": ("/telemetry", "yaw_rate_rad_s"),
    ".tlog": ("ATTITUDE", "yawspeed"),
    ".ulg": ("vehicle_angular_velocity", "xyz[2]"),
}


def test_each_kind_holds_the_same_flight(any_log, motion):
    series, column = YAW_RATE[any_log.suffix]
    table = open_log(any_log).table(series)
    assert open_log(any_log).records()[series] == len(table.time_s)
    wanted = [motion.yaw_rate_rad_s(time_s) for time_s in table.time_s]
    np.testing.assert_allclose(table.columns[column], wanted, atol=1e-6)
    assert table.time_s[0] == pytest.approx(5.0)


def test_a_log_is_known_by_its_bytes_not_by_its_name(any_log, tmp_path):
    renamed = any_log.rename(tmp_path / "renamed.bin")
    assert logs.main(["info", str(renamed)]) == 0


def test_info_names_series_counts_and_rates(any_log, capsys):
    assert logs.main(["info", str(any_log)]) == 0
    text = capsys.readouterr().out
    series, _ = YAW_RATE[any_log.suffix]
    line = next(line for line in text.splitlines() if line.endswith(f"  {series}"))
    rate = {".mcap": "10.0", ".tlog": "25.0", ".ulg": "50.0"}[any_log.suffix]
    count, first_s, _, hz, _ = line.split()
    assert (count, first_s, hz) == (str(round(20 * float(rate))), "5.000", rate)


def test_csv_holds_every_number(any_log, tmp_path, capsys):
    assert logs.main(["export", str(any_log), "--out", str(tmp_path / "csv")]) == 0
    paths = capsys.readouterr().out.split()
    log = open_log(any_log)
    assert len(paths) == len(log.records())
    series, column = YAW_RATE[any_log.suffix]
    name = f"{series.strip('/')}.csv"
    with (tmp_path / "csv" / name).open() as file:
        rows = list(csv.DictReader(file))
    table = log.table(series)
    np.testing.assert_array_equal([float(row["time_s"]) for row in rows], table.time_s)
    np.testing.assert_array_equal([float(row[column]) for row in rows], table.columns[column])


def test_unknown_numbers_are_empty_cells(tmp_path, invented, motion):
    log = invented.flight(tmp_path / "a.mcap", motion, yaw_known=False)
    words = ["export", str(log), "--out", str(tmp_path), "--series", "/telemetry"]
    assert logs.main(words) == 0
    with (tmp_path / "telemetry.csv").open() as file:
        assert {row["yaw_rate_rad_s"] for row in csv.DictReader(file)} == {""}


def test_parquet_holds_what_csv_holds(any_log, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    words = ["export", str(any_log), "--out", str(tmp_path), "--format", "parquet"]
    assert logs.main(words) == 0
    series, column = YAW_RATE[any_log.suffix]
    found = parquet.read_table(tmp_path / f"{series.strip('/')}.parquet")
    np.testing.assert_array_equal(found[column], open_log(any_log).table(series).columns[column])


def test_a_telemetry_log_survives_noise_between_frames(tmp_path, invented, motion):
    log = invented.tlog(tmp_path / "a.tlog", motion)
    whole = open_log(log).records()
    data = log.read_bytes()
    at = data.index(b"\xfd", 500) - 8
    log.write_bytes(data[:at] + b"\xfd\x02 some noise" + data[at:-5])
    health = open_log(log).examine()
    assert sum(health.records.values()) == sum(whole.values()) - 1
    assert [finding.problem for finding in health.findings][:2] == [False, True]


MISTAKES = {
    "missing": (lambda path: None, "cannot be read: No such file"),
    "empty": (lambda path: path.write_bytes(b""), "empty"),
    "text": (lambda path: path.write_text("hello, this is no log"), "no log of a known kind"),
    "zeros": (lambda path: path.write_bytes(bytes(9000)), "no log of a known kind"),
    "empty folder": (lambda path: path.mkdir(), "a folder without flight.mcap"),
    "ulog magic": (lambda path: path.write_bytes(b"ULog\x01\x12\x35"), "not a PX4 log"),
    "mcap magic": (lambda path: path.write_bytes(b"\x89MCAP0\r\n"), "not a flight log"),
}


@pytest.mark.parametrize("verb", ["info", "verify", "export"])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_no_log_is_one_line(tmp_path, capsys, verb, mistake):
    make, said = MISTAKES[mistake]
    make(tmp_path / "log")
    assert logs.main([verb, str(tmp_path / "log")]) == 1
    text = capsys.readouterr().err
    assert said in text
    assert str(tmp_path / "log") in text
    assert text.count("\n") == 1


def test_a_series_that_is_not_there_is_one_line(any_log, tmp_path, capsys):
    words = ["export", str(any_log), "--out", str(tmp_path), "--series", "nonsense"]
    assert logs.main(words) == 1
    assert "no series nonsense; it holds: " in capsys.readouterr().err
