"""Campaigns that are flown: killed and gone on with, on a cluster that loses a worker, and failing.

All fly the same small campaign, so that all must tell what the unbroken one tells.
"""

import csv
import json
import re
import signal
import subprocess

import pytest

from companion.flightlog import FlightLog
from tools.campaign.__main__ import main
from tools.campaign.results import LOGS_NAME, ROWS_NAME

ROOM = "size_m = [4.0, 4.0, 3.0]\ntexel_m = 0.02\n"
PLAN = 'room = "box"\n[experiment]\ninitial_s = 3.0\nlearning_s = 3.0\ntest_s = 3.0\n'
CAMPAIGN = """
plan = "box.toml"
runs = 5
[matrix]
experiment.scheme = ["pure_stereo", "training_wheels"]
"""
FLIGHTS = 10
POLL_PERIOD_S = 0.05


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """The campaign file, with a plan and a room that is painted in no time."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "rooms").mkdir()
    (folder / "rooms" / "box.toml").write_text(ROOM)
    (folder / "box.toml").write_text(PLAN)
    path = folder / "small.toml"
    path.write_text(CAMPAIGN)
    return path


@pytest.fixture(scope="module")
def unbroken(campaign):
    """The folder of the campaign, flown by the command as it stands."""
    out = campaign.parent / "unbroken"
    assert main([str(campaign), "--out", str(out), "--workers", "1"]) == 0
    return out


@pytest.fixture(scope="module")
def cluster(start, tmp_path_factory):
    """(address, workers): a scheduler and two workers on loopback, each a process of its own."""
    folder = tmp_path_factory.mktemp("cluster")
    address_file = folder / "scheduler.json"
    loopback = ("--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0")
    scheduler = start(
        "-m", "distributed.cli.dask_scheduler", *loopback, "--scheduler-file", address_file
    )
    wait_until(address_file.exists, scheduler)
    address = json.loads(address_file.read_text())["address"]
    single = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", folder)
    words = ("-m", "distributed.cli.dask_worker", address, *single)
    return address, [start(*words) for _ in range(2)]


def rows_in(out):
    path = out / ROWS_NAME
    return max(path.read_bytes().count(b"\n") - 1, 0) if path.exists() else 0


def wait_until(condition, process):
    """Looks every POLL_PERIOD_S; fails when the process ends before."""
    while not condition():
        try:
            process.process.wait(POLL_PERIOD_S)
        except subprocess.TimeoutExpired:
            continue
        pytest.fail(process.said())


def assert_same(out, unbroken):
    """Same tables, same rows but for wall time, same logs; nothing twice, nothing left over."""
    for name in ("table.csv", "tests.csv", "table.json", "table.md"):
        assert (out / name).read_bytes() == (unbroken / name).read_bytes()
    one, other = (sorted(figures(folder)) for folder in (out, unbroken))
    assert one == other
    assert len(one) == FLIGHTS
    logs = [
        {path.name: path.read_bytes() for path in logs_of(folder)} for folder in (out, unbroken)
    ]
    assert logs[0] == logs[1]
    assert len(logs[0]) == FLIGHTS


def figures(folder):
    with (folder / ROWS_NAME).open(newline="") as file:
        for row in csv.DictReader(file):
            yield [value for name, value in row.items() if name != "wall_s"]


def logs_of(folder):
    return (folder / LOGS_NAME).glob("*.mcap")


def test_every_flight_leaves_a_row_and_a_log_without_images(unbroken, campaign):
    assert rows_in(unbroken) == FLIGHTS
    for path in logs_of(unbroken):
        log = FlightLog(path)
        assert not log.truncated
        assert not any(topic.startswith("/camera") for topic in log.topics())
        assert re.fullmatch(rf"(\w+)-{log.metadata.seed:04d}-[0-9a-f]{{8}}", path.stem)


def test_killed_again_and_again_it_ends_with_the_same_table(start, cluster, campaign, unbroken):
    address, _ = cluster
    out = campaign.parent / "killed"
    words = ("-m", "tools.campaign", campaign, "--out", out, "--scheduler", address)
    for number in (signal.SIGKILL, signal.SIGINT, signal.SIGKILL):
        before = rows_in(out)
        process = start(*words)
        wait_until(lambda before=before: rows_in(out) > before, process)
        process.process.send_signal(number)
        code, said = process.wait()
        assert code != 0, said
        assert before < rows_in(out) < FLIGHTS
        if number == signal.SIGINT:
            last = said.splitlines()[-1]
            assert last == "campaign: stopped; the same command goes on from here", said
            assert "Traceback" not in said
    code, said = start(*words).wait()
    assert code == 0, said
    assert re.search(r"^[3-9] of 10 flights are there already$", said, re.MULTILINE)
    assert_same(out, unbroken)


def test_a_cluster_that_loses_a_worker_loses_no_flight(start, cluster, campaign, unbroken):
    address, workers = cluster
    out = campaign.parent / "cluster"
    flying = start("-m", "tools.campaign", campaign, "--out", out, "--scheduler", address)
    wait_until(lambda: rows_in(out) >= 2, flying)
    workers[0].kill()
    assert rows_in(out) < FLIGHTS
    code, said = flying.wait()
    assert code == 0, said
    assert_same(out, unbroken)


def test_a_failed_flight_is_told_and_the_rest_go_on(capsys, tmp_path, cluster, campaign):
    """Those at 7 Hz cannot be: the simulator's steps do not fit."""
    path = campaign.parent / "failing.toml"
    path.write_text('plan = "box.toml"\nruns = 1\n[matrix]\ncamera.rate_hz = [7.0, 10.0]\n')
    words = [str(path), "--out", str(tmp_path / "out"), "--scheduler", cluster[0]]
    assert main(words) == 1
    out, error = capsys.readouterr()
    (line,) = re.findall("^rate_hz=7.0, seed 1: failed: .*", error, re.MULTILINE)
    assert "camera rate 7 Hz: its period must be a whole number of physics steps" in line
    assert "rate_hz=10.0, seed 1: flown, " in error
    assert "2 flights, 1 failed; rows, logs and tables: " in out
    assert main(words) == 1  # flown once is enough: the same seed fails the same way
    assert "2 of 2 flights are there already" in capsys.readouterr().err


def test_a_cluster_of_another_version_is_refused(capsys, monkeypatch, tmp_path, cluster, campaign):
    monkeypatch.setattr("tools.campaign.run.__version__", "9.9")
    words = ["--scheduler", cluster[0], "--out", str(tmp_path / "out")]
    assert main([str(campaign), *words]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"campaign: --scheduler {cluster[0]}: tcp://127.0.0.1:")
    assert "no companion 9.9 with its tools there: " in error
    assert error.count("\n") == 1


def test_no_scheduler_is_one_line(capsys, tmp_path, campaign):
    words = ["--scheduler", "nonsense", "--out", str(tmp_path / "out")]
    assert main([str(campaign), *words]) == 1
    error = capsys.readouterr().err
    assert error.startswith("campaign: --scheduler nonsense: no Dask scheduler: ")
    assert error.count("\n") == 1
