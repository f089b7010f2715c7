"""Flights that remember, beside flights that do not."""

import csv
from pathlib import Path

from tools.lessons import main

PLAN = Path(__file__).parents[2] / "flightplans" / "room1.toml"
SHORT = ("experiment.initial_s=7", "experiment.learning_s=3", "experiment.test_s=2")


def test_what_a_flight_knows_it_has_from_the_one_before(tmp_path, capsys):
    out = tmp_path / "lessons"
    assert main([str(PLAN), "--flights", "2", "--out", str(out), "--set", *SHORT]) == 0
    with (out / "lessons.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["kind"], row["flight"], row["seed"]) for row in rows] == [
        ("with memory", "1", "1"), ("with memory", "2", "2"),
        ("without", "1", "1"), ("without", "2", "2"),
    ]  # fmt: skip
    first, second, first_fresh, second_fresh = (float(row["mse_initial"]) for row in rows)
    assert first == first_fresh
    assert second != second_fresh
    printed = capsys.readouterr().out.splitlines()
    assert printed[:3] == [str(out / f"lessons.{kind}") for kind in ("csv", "png", "svg")]
    assert printed[-1].startswith("| 2 | ")
