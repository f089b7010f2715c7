"""Campaigns as a user starts them: a folder with a campaign file, and the command in a process."""

import subprocess
import sys
from pathlib import Path

import pytest

OFFICE = Path(__file__).parents[3] / "flightplans" / "office.toml"
BRIEF = """
runs = 3
[set]
experiment = { initial_s = 2, learning_s = 2, test_s = 2 }
[matrix]
experiment.scheme = ["pure_stereo", "training_wheels"]
"""


@pytest.fixture
def campaign_file(tmp_path):
    """Writes a campaign of flights in the shipped office."""

    def write(text=BRIEF, name="small.toml"):
        path = tmp_path / name
        path.write_text(f'plan = "{OFFICE}"\n{text}')
        return path

    return write


class Process:
    """This Python with some words; what it says is kept for the test that fails."""

    def __init__(self, words, folder):
        self.output = (folder / f"{len(list(folder.iterdir()))}.txt").open("w+")
        self.process = subprocess.Popen(
            [sys.executable, *map(str, words)], stdout=self.output, stderr=subprocess.STDOUT
        )

    def wait(self):
        """Its exit code, and what it said."""
        code = self.process.wait(timeout=100)
        return code, self.said()

    def said(self):
        self.output.seek(0)
        return self.output.read()

    def kill(self):
        self.process.kill()
        self.process.wait()


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """``start("-m", "tools.campaign", ...)``; what is left of it after the tests is killed."""
    folder, started = tmp_path_factory.mktemp("said"), []

    def start(*words):
        started.append(Process(words, folder))
        return started[-1]

    yield start
    for one in started:
        one.kill()
        one.output.close()
