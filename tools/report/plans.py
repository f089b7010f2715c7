"""What was flown, beside what is flown by default."""

from collections.abc import Sequence

import msgspec

from companion.plan import Plan
from tools.report.flight import ReportedFlight
from tools.report.page import folded, table

HEADER = ("key", "flown", "default")
VALUES_TOLD = 5


def plan_flown(flight: ReportedFlight) -> str:
    """What is not the default; all keys folded."""
    flown, default = (_flat(msgspec.to_builtins(plan)) for plan in (flight.plan, Plan()))
    rows = [(key, value, default.get(key, "")) for key, value in sorted(flown.items())]
    changed = [row for row in rows if row[1] != row[2]]
    return table(HEADER, changed, words=True) + folded("all keys", table(HEADER, rows, words=True))


def plans_flown(flights: Sequence[ReportedFlight]) -> str:
    """What any flight had that is not the default, and every value that it had."""
    default = _flat(msgspec.to_builtins(Plan()))
    values: dict[str, list[str]] = {}
    for flight in flights:
        for key, value in _flat(msgspec.to_builtins(flight.plan)).items():
            known = values.setdefault(key, [])
            if value not in known:
                known.append(value)
    rows = [
        (key, _told(flown), default.get(key, ""))
        for key, flown in sorted(values.items())
        if flown != [default.get(key, "")]
    ]
    return table(HEADER, rows, words=True)


def _told(values: Sequence[str]) -> str:
    if len(values) > VALUES_TOLD:
        return f"{values[0]} … {values[-1]} ({len(values)} values)"
    return ", ".join(values)


def _flat(values: dict[str, object], prefix: str = "") -> dict[str, str]:
    flat: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = "–" if value is None else str(value)
    return flat
