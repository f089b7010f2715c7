"""What all logs have in common: named series of samples, and a state of health."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class Table(NamedTuple):
    """One series. ``time_s``: (n,) on the log's own clock; columns: (n,) or (n, k) for vectors."""

    time_s: NDArray[np.float64]
    columns: dict[str, NDArray[Any]]


class Finding(NamedTuple):
    """Something that a check saw; a problem makes the log unsound, a remark does not."""

    problem: bool
    text: str


class Health(NamedTuple):
    """What ``verify`` knows of a log. ``records``: count by series."""

    records: dict[str, int]
    findings: list[Finding]

    @property
    def sound(self) -> bool:
        return not any(finding.problem for finding in self.findings)


class LogReader(Protocol):
    """One log. All methods raise RecordingError for what cannot be read."""

    path: Path
    kind: str

    def facts(self) -> dict[str, str]:
        """What the log says about itself, by name."""
        ...

    def records(self) -> dict[str, int]:
        """Number of records by series."""
        ...

    def table(self, series: str) -> Table: ...

    def examine(self) -> Health: ...


def seconds(times_ns: Sequence[int] | NDArray[np.int64]) -> NDArray[np.float64]:
    return np.asarray(times_ns, dtype=np.float64) * 1e-9


def problem(text: str) -> Finding:
    return Finding(True, text)


def remark(text: str) -> Finding:
    return Finding(False, text)


def backward_steps(
    series: str, time_s: NDArray[np.float64], allowed_s: float = 0.0
) -> list[Finding]:
    """A finding where a clock runs backwards: a problem beyond ``allowed_s``."""
    steps_s = np.diff(time_s)
    back = np.flatnonzero(steps_s < 0)
    if not len(back):
        return []
    worst = back[np.argmin(steps_s[back])]
    judge = problem if steps_s[worst] < -allowed_s else remark
    return [
        judge(
            f"{series}: time steps back {len(back)} times, the most by {-steps_s[worst]:.3f} s "
            f"at {time_s[worst]:.3f} s"
        )
    ]


def gaps(series: str, time_s: NDArray[np.float64], longest_s: float) -> list[Finding]:
    """A finding where samples stay away for longer than ``longest_s``."""
    steps_s = np.diff(time_s)
    long = np.flatnonzero(steps_s > longest_s)
    if not len(long):
        return []
    worst = long[np.argmax(steps_s[long])]
    return [
        problem(
            f"{series}: {len(long)} gaps longer than {longest_s:g} s, the longest "
            f"{steps_s[worst]:.2f} s at {time_s[worst]:.2f} s"
        )
    ]
