"""Mutated input for everything that reads something from outside.

In the ordinary run Hypothesis mutates a little; ``--fuzz-minutes N`` spends so long on each target,
and the count of executions is printed at the end.
"""

import resource
import signal
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.clock import wall_s
from companion.kernel.errors import CompanionError
from companion.kernel.messages import StereoFrame

EXAMPLES = 60
HANG_S = 20
"""Wall time for one input; a thousand times what the slowest target takes."""
GROWTH_LIMIT_MB = 400.0
"""Of the peak of resident memory, over all inputs of one target."""
EDGES = [
    *(bytes((value,)) for value in (0, 1, 0x7F, 0x80, 0xFF)),
    *b"- nan 1e999 -1 0 99999999999999999999 [ ] { } \" ' = , .".split(),
    *(b"\n", bytes(4), b"\xff" * 4, b"[" * 3000, b'{"a":' * 3000, b"x" * 300),
]


def pytest_addoption(parser):
    parser.addoption("--fuzz-minutes", type=float, default=0.0, help="for each target")


def pytest_terminal_summary(terminalreporter):
    for report in terminalreporter.getreports("passed") + terminalreporter.getreports("failed"):
        for key, counts in report.user_properties:
            if key == "fuzz":
                executions, duration_s, refused = counts
                name = report.nodeid.rpartition("::")[2].removeprefix("test_")
                terminalreporter.line(
                    f"{name}: {executions} executions in {duration_s:.0f} s, {refused} refused"
                )


class Mutator:
    """Draws inputs from seeds by what breaks parsers: cuts, copies, flips, splices, edge values."""

    def __init__(self, seeds, rng):
        self._seeds = [bytes(seed) for seed in seeds]
        self._rng = rng

    def draw(self):
        data = bytearray(self._any_seed())
        for _ in range(self._rng.integers(0, 6)):
            self._change(data)
        return bytes(data)

    def _any_seed(self):
        return self._seeds[self._rng.integers(len(self._seeds))]

    def _change(self, data):
        rng = self._rng
        start = int(rng.integers(len(data) + 1))
        end = min(len(data), start + int(rng.geometric(0.05)))
        match int(rng.integers(7)):
            case 0:
                del data[start:end]
            case 1:
                del data[start:]
            case 2:
                data[start:start] = data[start:end] * int(rng.integers(1, 5))
            case 3:
                data[start:end] = EDGES[rng.integers(len(EDGES))]
            case 4:
                data[start:end] = rng.bytes(end - start)
            case 5 if start < len(data):
                data[start] ^= 1 << int(rng.integers(8))
            case 6:
                other = self._any_seed()
                place = int(rng.integers(len(other) + 1))
                data[start:end] = other[place : place + int(rng.geometric(0.02))]


@contextmanager
def no_hang():
    def ring(_number, _frame):
        raise TimeoutError(f"still at it after {HANG_S} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(HANG_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def peak_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


class Target:
    """Counts what ``run`` does with inputs: success or the project's own error, nothing else."""

    def __init__(self, run, keep):
        self.executions = self.refused = 0
        self._run = run
        self._keep = keep

    def execute(self, data):
        self.executions += 1
        said = "fine"
        try:
            with no_hang():
                self._run(data)
        except CompanionError as error:
            self.refused += 1
            said = str(error)
        except BaseException:
            self._keep.write_bytes(data)  # the newest is the smallest that Hypothesis found
            raise
        assert len(said.splitlines()) == 1, f"not one line: {said!r}"


@pytest.fixture(scope="session")
def camera():
    """Calibration of the cameras that took ``pair``."""
    eye = Intrinsics(100.0, 100.0, 64.0, 48.0)
    return StereoCalibration(128, 96, eye, eye, 0.06)


@pytest.fixture
def pair():
    left, right = np.random.default_rng(1).integers(0, 256, (2, 96, 128), dtype=np.uint8)
    return StereoFrame(0, left, right)


@pytest.fixture
def fuzz(request, tmp_path, record_property):
    """``fuzz(run, seeds)``: calls ``run`` with mutations of the seeds."""
    minutes = request.config.getoption("fuzz_minutes", default=0.0)

    def fuzz(run, seeds):
        target, began_s = Target(run, tmp_path / "culprit"), wall_s()
        for seed in seeds:
            target.execute(seed)
        first_peak_mb = peak_mb()
        if minutes:
            mutator = Mutator(seeds, np.random.default_rng(round(began_s * 1e3)))
            while wall_s() < began_s + 60.0 * minutes:
                target.execute(mutator.draw())
        else:
            _with_hypothesis(target, seeds)
        record_property("fuzz", (target.executions, wall_s() - began_s, target.refused))
        assert peak_mb() - first_peak_mb < GROWTH_LIMIT_MB

    return fuzz


def _with_hypothesis(target, seeds):
    @settings(
        max_examples=EXAMPLES,
        database=None,
        suppress_health_check=list(HealthCheck),  # slow and large inputs are what is looked for
    )
    @given(st.integers(0, 2**32 - 1) | st.binary(max_size=64))
    def mutate(choice):
        if isinstance(choice, bytes):
            target.execute(choice)
        else:
            target.execute(Mutator(seeds, np.random.default_rng(choice)).draw())

    mutate()
