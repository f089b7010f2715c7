"""The command line's words; what flights make of them is in the scenarios."""

import logging

import pytest

from companion import cli
from companion.cli import main


def test_help_explains_the_options(capsys):
    assert main(["fly", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("--vehicle", "--camera", "lockstep", "udpin://", "--set"))


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["hover"],
        ["fly"],
        ["fly", "plan.toml", "--speed", "0"],
        ["fly", "plan.toml", "--speed", "nan"],
        ["fly", "plan.toml", "--seed", "-1"],
        ["fly", "plan.toml", "--wings"],
        ["learn"],
        ["learn", "a", "--train", "b", "--test", "c"],
        ["learn", "--train", "b"],
    ],
)
def test_misuse_is_exit_code_2(words, capsys):
    assert main(words) == 2
    out, error = capsys.readouterr()
    assert "Traceback" not in out + error


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["--train", "A", "B"], ["--train", "A", "--train", "B"]),
        (["--test", "A", "B", "--json", "f"], ["--test", "A", "--test", "B", "--json", "f"]),
        (["--set", "a=1", "b=2", "plan"], ["--set", "a=1", "--set", "b=2", "plan"]),
        (["plan", "--seed", "3"], ["plan", "--seed", "3"]),
    ],
)
def test_an_option_takes_several_values(words, meant):
    assert cli._spread(words) == meant


def test_an_interrupt_before_there_is_a_flight_is_one_line(capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("companion.plan.load_plan", interrupted)
    assert main(["fly", "plan.toml"]) == 1
    assert capsys.readouterr().err.split("\n")[-2:] == ["companion: interrupted", ""]


def test_log_lines_go_to_the_stderr_of_the_moment(capsys):
    record = logging.makeLogRecord({"msg": "no new %s", "args": ("frame",)})
    cli.StderrHandler().emit(record)
    assert capsys.readouterr().err == "no new frame\n"
