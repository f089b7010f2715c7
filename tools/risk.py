"""What mistakes cost in flight: the performance model's figures beside what was observed.

python -m tools.risk LOG/flight.mcap [--json FILE]
python -m tools.risk LOGS ...

The model (paper section III-E, judging/risk.py) is fitted twice at the threshold that mono had in
the test phase: to the samples before it, which is what the robot could know, and to its own. For
several flights, or folders of them, one line each: what was expected in the test phase, and what
came. The JSON holds a report for one flight, a list of reports for several.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np

from tools.agreement import agreement, expectation
from tools.assessment import Figure, Report, assess
from tools.drawing import run
from tools.flown import FlownFlight, find_logs
from tools.progress import watched

ROWS = {
    "true positive rate": "tpr",
    "false positive rate": "fpr",
    "Ω, silent on a positive after silence": "silence",
    "collision per approach, independent": "collision_iid",
    "collision per approach, chain": "collision",
    "override per approach, chain": "override",
    "spurious turns per s, independent": "spurious_turns_per_s_iid",
    "spurious turns per s, chain": "spurious_turns_per_s",
    "spurious turns per m, chain": "spurious_turns_per_m",
}
HEADER = ("", "from learning", "from test", "observed")


def table_lines(report: Report) -> Iterator[str]:
    """The report for a person."""
    yield f"{report.flight}: {conditions(report)}"
    for name, learning, test, observed in (HEADER, *table_rows(report)):
        yield f"{name:38}{learning:>26}{test:>26}{observed:>10}".rstrip()
    yield footnote(report)


def conditions(report: Report) -> str:
    """What the figures hold for."""
    return (
        f"mono turns above λ = {report.threshold_px:.2f} px, positive above "
        f"{report.positive_threshold_px:.2f} px; {report.positives_to_collision} positive frames "
        f"to a collision, {report.positives_to_override} to an override"
    )


def footnote(report: Report) -> str:
    return f"in brackets: {report.interval_norm:.0%} bootstrap intervals over approaches"


def table_rows(report: Report) -> Iterator[tuple[str, ...]]:
    """Under HEADER."""
    learning, test, observed = report.from_learning, report.from_test, report.observed
    for name, field in ROWS.items():
        seen = getattr(observed, field, None)
        predicted = (_text(getattr(prediction, field)) for prediction in (learning, test))
        yield name, *predicted, "" if seen is None else _number(seen)
    counts = (f"{p.approaches} ({p.positives} of {p.samples})" for p in (learning, test))
    yield "approaches (positive frames)", *counts, str(observed.mono_approaches)


def _text(figure: Figure) -> str:
    if math.isnan(figure.value):
        return "–"
    return f"{_number(figure.value)} [{_number(figure.low)}, {_number(figure.high)}]"


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2g}"


def comparison_lines(reports: Sequence[Report], rng: np.random.Generator) -> Iterator[str]:
    """Expected and observed overrides of each flight, and of all for which both are known."""
    columns = ("expected from learning", "expected from test", "observed")
    yield f"{'overrides in the test phase':44}" + "".join(f"{name:>26}" for name in columns)
    expectations = [expectation(report) for report in reports]
    for flight, learning, test, observed in expectations:
        yield _comparison(flight, _text(learning), _text(test), _number(observed))
    total = agreement(expectations, rng)
    sums = (total.from_learning, total.from_test, total.observed)
    yield _comparison(f"all, where known ({total.flights})", *(f"{value:.1f}" for value in sums))
    ratios = (_text(total.ratio_learning), _text(total.ratio_test))
    yield _comparison("observed / expected", *ratios, "")


def _comparison(name: str, *cells: str) -> str:
    return (f"{name:44}" + "".join(f"{cell:>26}" for cell in cells)).rstrip()


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.risk",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", type=Path, nargs="+", help="flights, or folders that hold them")
    parser.add_argument("--json", type=Path, help="also write the figures here")
    parser.add_argument("--seed", type=int, default=1, help="of the bootstrap")
    args = parser.parse_args(argv)

    def work() -> Iterator[str]:
        logs = watched(find_logs(args.logs), "flights")
        reports = [assess(FlownFlight(path), args.seed) for path in logs]
        alone = len(reports) == 1
        if args.json:
            text = msgspec.json.encode(reports[0] if alone else reports)
            args.json.write_bytes(msgspec.json.format(text, indent=2) + b"\n")
        rng = np.random.default_rng(args.seed)
        yield from table_lines(reports[0]) if alone else comparison_lines(reports, rng)

    return run("risk", work)


if __name__ == "__main__":
    sys.exit(main())
