"""What came of the flights: a row for each, and a table of the kinds."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from tools.faults.cases import Outcome

MOST_LOST_S = 1.0
"""Of the log's end: what is older must not be lost."""


class Flown(NamedTuple):
    """One flight with a fault."""

    way: str
    """lockstep or mavlink"""
    case: str
    moment: str
    room: str
    seed: int
    expected: Outcome
    observed: Outcome
    collisions: int
    lost_s: float
    """Of the log, before its last frame in flight."""
    reason: str = ""
    landing_contacts: int = 0
    """With furniture, on the way down; in lockstep they are not among the collisions."""
    fell: bool = False
    """Off furniture, once it had landed and stopped its motors; no crash of the flight."""

    @property
    def as_expected(self) -> bool:
        return self.observed is self.expected

    @property
    def good(self) -> bool:
        return self.as_expected and self.collisions == 0 and self.lost_s <= MOST_LOST_S

    def without_folder(self, folder: str) -> "Flown":
        """Its reason with paths from there on: so that the same flight makes the same row."""
        return self._replace(reason=self.reason.replace(f"{folder}/", ""))


COLUMNS = (
    "fault", "when", "expected", "flights", "as expected", "otherwise", "collisions", "fly-aways",
    "logs that lost more than 1 s", "touched furniture while landing",
    "fell off it afterwards",
)  # fmt: skip


def table(flights: Sequence[Flown]) -> Iterator[str]:
    """Markdown, a line for each fault and moment, over all rooms and seeds."""
    yield f"| {' | '.join(COLUMNS)} |"
    yield "|" + "---|" * len(COLUMNS)
    kinds = dict.fromkeys((flown.way, flown.case, flown.moment) for flown in flights)
    for kind in kinds:
        yield _line([flown for flown in flights if (flown.way, flown.case, flown.moment) == kind])


def _line(flights: Sequence[Flown]) -> str:
    first = flights[0]
    others = [flown.observed for flown in flights if not flown.as_expected]
    counts = {outcome: others.count(outcome) for outcome in dict.fromkeys(others)}
    cells = (
        first.case,
        first.moment if first.way == "lockstep" else f"{first.moment}, over MAVLink",
        first.expected,
        len(flights),
        f"{1 - len(others) / len(flights):.0%}",
        ", ".join(f"{count} {outcome}" for outcome, count in counts.items()) or "–",
        sum(flown.collisions for flown in flights),
        sum(flown.observed is Outcome.FLIES_AWAY for flown in flights),
        sum(flown.lost_s > MOST_LOST_S for flown in flights),
        sum(flown.landing_contacts > 0 for flown in flights),
        sum(flown.fell for flown in flights),
    )
    return f"| {' | '.join(map(str, cells))} |"
