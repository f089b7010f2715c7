"""Every flight plan that ships, flown in this process and in another: the same bytes."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from flightcard.flown import fly_in_lockstep

PLANS = sorted((Path(__file__).parents[2] / "flightplans").glob("*.toml"))
SHORT = (
    "experiment.initial_s=2",
    "experiment.learning_s=2",
    "experiment.test_s=1",
    "learner.textons.training_images=8",
)
FILES = ("flight.mcap", "model.npz")
IN_ANOTHER_PROCESS = """
import json, sys, tempfile
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_repeatability import PLANS, hashes
with tempfile.TemporaryDirectory() as folder:
    print(json.dumps({plan.name: hashes(plan, Path(folder) / plan.stem) for plan in PLANS}))
"""


def hashes(plan, log_dir):
    """SHA-256 of what a short flight of this plan leaves."""
    log_dir.mkdir()
    flown = fly_in_lockstep(plan, SHORT, log_dir)
    return [hashlib.sha256(flown.bytes_of(name)).hexdigest() for name in FILES]


@pytest.fixture(scope="module")
def of_another_process():
    """By the plan's name; the order of sets and of the address space differ there."""
    done = subprocess.run(
        [sys.executable, "-c", IN_ANOTHER_PROCESS, str(Path(__file__).parent)],
        env={**os.environ, "PYTHONHASHSEED": "7"},
        stdout=subprocess.PIPE,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.mark.timeout(300)  # the first one waits for all flights of the other process
@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.stem)
def test_two_flights_of_a_plan_leave_the_same_bytes(plan, tmp_path, of_another_process):
    assert hashes(plan, tmp_path / "log") == of_another_process[plan.name]
