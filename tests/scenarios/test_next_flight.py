"""What one flight learned, the next one knows; and what the last one left unfinished."""

import json
from pathlib import Path

import numpy as np
import pytest

from companion.cli import main
from companion.flightlog import FlightLog
from companion.kernel.errors import VehicleError
from companion.logfolder import KILLED
from companion.memory import MODEL_NAME, previous_of

PLANS = Path(__file__).parents[2] / "flightplans"
BRIEF = {"initial_s": 8, "learning_s": 4, "test_s": 2}
WORDS = [word for key, value in BRIEF.items() for word in ("--set", f"experiment.{key}={value}")]


@pytest.fixture
def fly(tmp_path, capsys):
    """Flies in lockstep; (exit code, last line on stderr, the folders so far)."""

    def fly(*words):
        command = ["fly", str(PLANS / "office.toml"), "--vehicle", "lockstep", *WORDS, *words]
        code = main([*command, "--log-dir", str(tmp_path / "logs")])
        lines = capsys.readouterr().err.splitlines()
        return code, lines[-1] if lines else "", sorted((tmp_path / "logs").iterdir())

    return fly


def mono_px(folder):
    return FlightLog(folder / "flight.mcap").columns("/percept")["mono_px"]


def summary_of(folder):
    return json.loads((folder / "summary.json").read_bytes())


@pytest.mark.parametrize("preset", ["paper", "best"])
def test_the_next_flight_knows_what_the_last_one_learned(fly, preset):
    words = ("--set", f"learner.preset={preset}", "--set", "log.model_period_s=5")
    _, _, (first,) = fly(*words)
    logs = str(first.parent)
    code, _, folders = fly(*words, "--seed", "2", "--model", logs)
    assert code == 0
    (second,) = set(folders) - {first}
    assert np.isnan(mono_px(first)[0])
    assert np.isfinite(mono_px(second)).all()
    sizes = [np.load(f / MODEL_NAME)[_samples(preset)].size for f in (first, second)]
    assert sizes[1] > sizes[0]
    phases = FlightLog(second / "flight.mcap").columns("/decision")["phase"]
    assert list(dict.fromkeys(phases)) == list(name[:-2] for name in BRIEF)  # all are flown again
    assert {path.name for path in second.iterdir()} == {
        *("flight.mcap", "summary.json", "model.npz", "model.previous.npz")
    }


def _samples(preset):
    return "estimator.regressor.y" if preset == "paper" else "estimator.regressor.1.y"


def test_a_spoilt_model_falls_back_and_one_that_does_not_fit_is_refused(fly):
    _, _, (first,) = fly("--set", "log.model_period_s=5")
    newest = first / MODEL_NAME
    newest.write_bytes(newest.read_bytes()[:-1])
    code, line, folders = fly("--seed", "2", "--model", str(newest))
    assert code == 0
    assert str(previous_of(newest)) in line or np.isfinite(mono_px(folders[-1])[0])
    for words, said in (
        (
            ("--set", "learner.eye=right"),
            "learned with learner.eye = 'left'; the plan says 'right'",
        ),
        (("--set", "sitl.camera.width_px=160"), "model of a 128 x 96 camera; this one is 160 x 96"),
    ):
        code, line, now = fly("--model", str(first), *words)
        assert (code, said in line, now) == (2, True, folders), line
    previous_of(newest).unlink()
    code, line, _ = fly("--model", str(first))
    assert (code, line.split(": ", 2)[2][:17]) == (2, "not a saved model"), line


def test_a_vehicle_that_landed_alone_is_not_flown_again_unasked(fly):
    _, _, (first,) = fly()
    summary = summary_of(first)
    (first / "summary.json").write_text(json.dumps(summary | {"reason": KILLED}))
    code, line, folders = fly("--resume")
    assert (code, folders) == (1, [first])
    assert line.endswith("interrupted, and the vehicle has landed alone; start again to fly")
    assert summary_of(first)["reason"].endswith("the vehicle landed without it")
    code, _, folders = fly("--resume", "--seed", "2")
    assert (code, len(folders)) == (0, 2)


@pytest.mark.flight(plan="hover")
def test_a_vehicle_that_flies_already_is_not_ours(lockstep):
    lockstep.take_off(1.0)
    with pytest.raises(VehicleError, match=r"flies already \(hold mode\); --resume takes it over"):
        lockstep.fly_plan()
    assert lockstep.telemetry.armed
