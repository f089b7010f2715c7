"""The matrix of faults: what is stated before flying is what the table holds flights against."""

import csv
import tempfile

import pytest

from tools.faults.__main__ import main
from tools.faults.cases import CASES, MAVLINK_ONLY, Outcome, events_of
from tools.faults.lockstep import Task, fly
from tools.faults.results import Flown, table


def test_every_fault_has_a_name_of_its_own_and_an_outcome_that_may_be_wanted():
    names = [case.name for case in (*CASES, *MAVLINK_ONLY)]
    assert len(set(names)) == len(names)
    wanted = {case.expected for case in CASES}
    assert wanted <= {Outcome.FLIES, Outcome.HOLDS, Outcome.LANDS, Outcome.REFUSES}


def test_a_fault_comes_at_its_moment_and_goes_when_it_passes():
    (case,) = (case for case in CASES if case.name == "link lost for 5 s")
    cut, clear = events_of(case, "learning")
    assert (cut["link_loss_norm"], clear["link_loss_norm"]) == (1.0, 0.0)
    assert clear["at_s"] - cut["at_s"] == 5.0
    assert cut["at_s"] == 30.0  # take-off, and 20 s of flight


def flown(**changes):
    fields = {
        **{"way": "lockstep", "case": "none", "moment": "test", "room": "room1", "seed": 1},
        **{"expected": Outcome.FLIES, "observed": Outcome.FLIES, "collisions": 0, "lost_s": 0.2},
    }
    return Flown(**(fields | changes))


def test_the_table_counts_what_went_otherwise():
    rows = [
        flown(),
        flown(observed=Outcome.FLIES_AWAY, collisions=2),
        flown(observed=Outcome.LANDS, lost_s=1.5, landing_contacts=1, fell=True),
        flown(way="mavlink", moment="initial"),
    ]
    assert [row.good for row in rows] == [True, False, False, True]
    _, _, first, second = table(rows)
    assert first == (
        "| none | test | keeps flying | 3 | 33% | 1 flies away, 1 lands | 2 | 1 | 1 | 1 | 1 |"
    )
    assert second.startswith("| none | initial, over MAVLink | keeps flying | 1 | 100% | – | 0 |")


@pytest.mark.parametrize("fault", ["disk full", "model spoilt at start"])
def test_a_fault_is_flown_and_noted(tmp_path, capsys, fault):
    words = ["--seeds", "1", "--mavlink-seeds", "0", "--rooms", "room1", "--workers", "1"]
    assert main([*words, "--only", fault, "--out", str(tmp_path)]) == 0
    with (tmp_path / "faults.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["case"], row["as_expected"], row["collisions"]) == (fault, "True", "0")
    assert float(row["lost_s"]) < 1.0
    assert tempfile.gettempdir() not in row["reason"]
    assert capsys.readouterr().out.splitlines()[-1] == "1 flights, 0 not as they should be"


ONE = ["--seeds", "1", "--mavlink-seeds", "0", "--rooms", "room1", "--only", "none"]


def fail(monkeypatch):
    monkeypatch.setattr(
        "tools.faults.__main__._fly_all",
        lambda tasks, workers: [flown(collisions=1) for _ in tasks],
    )


def test_a_matrix_goes_on_where_it_ended(tmp_path, capsys, monkeypatch):
    fail(monkeypatch)
    main([*ONE, "--out", str(tmp_path)])
    path = tmp_path / "faults.csv"
    first = path.read_text()
    path.write_text(first + "lockstep,none,room")
    monkeypatch.setattr("tools.faults.__main__._fly_all", lambda tasks, workers: tasks[:0])
    assert main([*ONE, "--out", str(tmp_path)]) == 1
    assert path.read_text() == first
    assert "1 flights, 1 not as they should be" in capsys.readouterr().out


def test_a_table_of_something_else_is_left_alone(tmp_path, capsys):
    path = tmp_path / "faults.csv"
    path.write_text("id,group\n1,2\n")
    assert main([*ONE, "--out", str(tmp_path)]) == 1
    assert "faults.csv: not a table of tools.faults" in capsys.readouterr().err
    assert path.read_text() == "id,group\n1,2\n"


def test_a_fault_that_does_not_exist_is_no_success(tmp_path, capsys):
    assert main(["--only", "lightning", "--out", str(tmp_path / "out")]) == 2
    assert "faults: --only lightning: no fault is called so" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_is_not_as_expected_is_exit_code_1(tmp_path, capsys, monkeypatch):
    fail(monkeypatch)
    assert main([*ONE, "--out", str(tmp_path)]) == 1
    assert "faults: 1 flights not as they should be" in capsys.readouterr().err


def test_a_place_where_caution_sees_no_way_is_left():
    """Beside the corridor's wall: turning on for ever, it was carried against it."""
    (case,) = (case for case in CASES if case.name == "left eye black, learned")
    it = fly(Task(case, "trusted", "corridor", seed=8))
    assert (it.observed, it.collisions) == (Outcome.FLIES, 0)
