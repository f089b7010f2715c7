"""What a person and a program are told about a flight, also where there is little to tell."""

import io
import json
import math

import msgspec
import pytest
from rich.console import Console

from companion.console import Progress, print_result
from companion.flying.safety import Reaction, Verdict
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import BehaviourState, Cue, Decision, Percept, Phase, Setpoint
from companion.pipeline import Pipeline, Step
from companion.plan import Plan
from companion.summary import FlightFacts, summarise, table_rows

EYE = Intrinsics(focal_x_px=100.0, focal_y_px=100.0, centre_x_px=63.5, centre_y_px=47.5)
CALIBRATION = StereoCalibration(width_px=128, height_px=96, left=EYE, right=EYE, baseline_m=0.06)
LONG_NAME = "a_very_long_plan_name_for_a_flight_that_nobody_would_choose_but_somebody_will"


@pytest.fixture(scope="module")
def pipeline():
    return Pipeline(Plan(), CALIBRATION)


@pytest.fixture
def summary(pipeline):
    """Of a flight that ended before its first frame."""
    return summarise(Plan(), LONG_NAME, pipeline, FlightFacts(reason="no take-off"))


def test_undefined_figures_are_a_dash_in_the_table(summary):
    rows = dict(table_rows(summary))
    for name in (
        "Mean square error, px²",
        "False positive rate",
        "True positive rate",
        "Area under the ROC curve",
        "Overrides per minute (test)",
    ):
        assert rows[name] == "–"
    assert rows["Collisions (truth)"] == "unknown"
    assert rows["Stereo flight time, m:ss"] == "0:00"
    assert not any("nan" in value for value in rows.values())


def test_undefined_figures_are_null_in_the_file(summary):
    table = json.loads(msgspec.json.encode(summary))
    assert (table["outcome"], table["reason"]) == ("failed", "no take-off")
    assert [table[key] for key in ("mse", "auc", "real_time_factor", "collisions")] == [None] * 4
    assert list(table["phases"]) == ["initial", "learning", "test"]
    truth = ("collisions", "distance_flown_m", "cells_visited")
    assert [table["phases"]["test"][key] for key in truth] == [None] * 3


def test_known_figures_are_told(pipeline):
    facts = FlightFacts(outcome="flown", sim_s=600.0, wall_s=60.0, collisions=0)
    summary = summarise(Plan(), "mine", pipeline, facts)
    assert summary.real_time_factor == pytest.approx(10.0)
    assert dict(table_rows(summary))["Collisions (truth)"] == "0"


def shown(width_columns, terminal, draw):
    """What ``draw(console)`` puts on a console."""
    file = io.StringIO()
    draw(
        Console(
            file=file, width=width_columns, force_terminal=terminal, color_system=None, _environ={}
        )
    )
    return file.getvalue()


def test_the_result_does_not_wrap_a_long_name(summary):
    text = shown(80, False, lambda console: print_result(console, summary, f"logs/{LONG_NAME}"))
    lines = text.splitlines()
    assert lines[0] == f"{LONG_NAME}, seed 1, training_wheels"
    assert lines[-1].endswith(f"(–); log: logs/{LONG_NAME}")


def step(time_s, override=False):
    """The widest words that a step can hold."""
    stamp_ns = round(time_s * 1e9)
    percept = Percept(
        stamp_ns=stamp_ns,
        stereo_px=12.3,
        stereo_valid_norm=1.0,
        mono_px=math.nan,
        mono_std_px=math.nan,
    )
    decision = Decision(
        stamp_ns=stamp_ns,
        phase=Phase.LEARNING,
        cue=Cue.STEREO if override else Cue.MONO,
        override=override,
        disparity_px=12.3,
        threshold_px=3.0,
        state=BehaviourState.STRAIGHT,
        overrides=123,
        turns=123,
        approaches=3,
    )
    return Step(percept, decision, Verdict(Setpoint(stamp_ns=stamp_ns), Reaction.FLY, ""))


def fly_for(duration_s, pipeline):
    def draw(console):
        with Progress(console) as progress:
            for time_s in range(duration_s):
                progress.show(step(time_s, override=time_s % 2 == 0), pipeline)

    return draw


def test_elsewhere_than_on_a_terminal_there_is_a_whole_line_every_30_s(pipeline):
    lines = shown(40, False, fly_for(61, pipeline)).splitlines()
    assert [line[:7] for line in lines] == ["    0 s", "   30 s", "   60 s"]
    assert lines[0].endswith("  –")
    assert not any("nan" in line for line in lines)


def test_the_live_table_fits_a_terminal_of_80_columns(pipeline):
    text = shown(80, True, fly_for(2, pipeline))
    assert "stereo (override)" in text
    assert "…" not in text
    assert "nan" not in text
