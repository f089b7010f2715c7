"""Flights that are killed leave a log and a model that the next one can use."""

import csv

from tools.kills.__main__ import main

SHORT = ("experiment.initial_s=5", "experiment.learning_s=6", "experiment.test_s=3")


def test_three_kills_lose_no_more_than_a_second(tmp_path, capsys):
    out = tmp_path / "kills"
    assert main(["--n", "3", "--seed", "4", "--out", str(out), "--set", *SHORT]) == 0
    assert "3 of 3 recovered; at most 0." in capsys.readouterr().out.splitlines()[-1]
    with (out / "kills.csv").open() as file:
        kills = list(csv.DictReader(file))
    assert [kill["problem"] for kill in kills] == [""] * 3
    assert all(0.0 <= float(kill["lost_s"]) <= 1.0 for kill in kills)


def test_a_flight_that_cannot_be_flown_is_one_line(tmp_path, capsys):
    words = ["--out", str(tmp_path / "kills"), "--set", "behaviour.height_m=9"]
    assert main(words) == 2
    assert capsys.readouterr().err.startswith("kills: ")


def test_the_folder_must_be_new(tmp_path, capsys):
    assert main(["--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"kills: {tmp_path}: File exists\n"
